"""The sum of the fixed beams' squared differences as a second-order polynomial of the motion."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, helper, uint64
from mavnav.kernels.polar_search.cost import Beams, Work, lower_ranges, span, to_polar
from mavnav.kernels.polar_search.fixed_beams import HalfWindow


@helper
def _derive(scan: Beams, motion: F64_1D, window: HalfWindow, path: F64_1D, r: F64_1D, rates: F64_2D) -> None:
    """Write the first three derivatives of the points' ranges, and of their beam numbers, along a path.

    ``path`` (3,) is the speed of x, of y and of the turn about the pivot. With a point as a complex number, range and
    bearing are the real and imaginary part of its logarithm: (a, b), (e, f) are the first and second derivatives of the
    point divided by the point itself.
    """
    points, (c, s, x, y, _), (right, up, turn) = scan.points, motion, path
    per_step, pivot_x, pivot_y = 1.0 / scan.limits.step_rad, window.pivot_x_m, window.pivot_y_m
    for k in range(points.shape[1]):
        qx, qy = c * points[0, k] - s * points[1, k] + x, s * points[0, k] + c * points[1, k] + y
        ox, oy, per = turn * (qx - pivot_x), turn * (qy - pivot_y), 1.0 / (qx * qx + qy * qy)
        tx, ty = right - oy, up + ox
        a, b = (tx * qx + ty * qy) * per, (ty * qx - tx * qy) * per
        e, f = -turn * (ox * qx + oy * qy) * per, -turn * (oy * qx - ox * qy) * per
        a2, b2 = e - a * a + b * b, f - 2.0 * a * b
        a3 = -turn * turn * a - 3.0 * (a * e - b * f) + 2.0 * a * (a * a - 3.0 * b * b)
        b3 = -turn * turn * b - 3.0 * (a * f + b * e) + 2.0 * b * (3.0 * a * a - b * b)
        rates[0, k], rates[1, k], rates[2, k] = r[k] * a, r[k] * (a2 + a * a), r[k] * (a3 + 3.0 * a * a2 + a * a * a)
        rates[3, k], rates[4, k], rates[5, k] = per_step * b, per_step * b2, per_step * b3


@helper
def _expand(work: Work, beams: F64_2D, segments: I64_1D, rates: F64_2D, terms: F64_2D) -> None:
    """Write the squared differences of fixed beams, their first two derivatives, and the absolute value of the third.

    ``beams`` (2, m) are the numbers of the fixed beams and their differences, ``segments`` (m,) the segments that they
    meet.
    """
    r, beam = work.r, work.beam
    for i in range(len(segments)):
        k = uint64(segments[i])
        b = uint64(segments[i] - 1)
        v, per, d = r[k] - r[b], 1.0 / (beam[k] - beam[b]), beams[1, i]
        a1, a2, a3, b1, b2, b3 = rates[0, b], rates[1, b], rates[2, b], rates[3, b], rates[4, b], rates[5, b]
        v1, v2, v3 = rates[0, k] - a1, rates[1, k] - a2, rates[2, k] - a3
        w1, w2, w3 = rates[3, k] - b1, rates[4, k] - b2, rates[5, k] - b3
        u = (beams[0, i] - beam[b]) * per  # the share of the segment's length at which the beam meets it, (j - b) / w
        u1 = -(b1 + u * w1) * per
        u2 = -(b2 + u * w2 + 2.0 * u1 * w1) * per
        u3 = -(b3 + u * w3 + 3.0 * (u1 * w2 + u2 * w1)) * per
        d1, d2 = a1 + u1 * v + u * v1, a2 + u2 * v + 2.0 * u1 * v1 + u * v2
        d3 = a3 + u3 * v + 3.0 * (u2 * v1 + u1 * v2) + u * v3
        terms[0, i], terms[1, i] = d * d, 2.0 * d * d1
        terms[2, i], terms[3, i] = 2.0 * (d1 * d1 + d * d2), 2.0 * abs(3.0 * d1 * d2 + d * d3)


@helper
def _sum_up(terms: F64_2D, sums: F64_1D) -> None:
    """Sum rows (4, m) pairwise, in SIMD lanes."""
    for i in range(len(terms)):
        row, n = terms[i], terms.shape[1]
        while n > 1:
            half = (n + 1) // 2
            for j in range(n - half):
                row[j] += row[half + j]
            n = half
        sums[i] = row[0] if terms.shape[1] else 0.0


@helper
def polynomial(scan: Beams, motion: F64_1D, window: HalfWindow, work: Work, seen: F64_1D, fixed: I64_1D) -> F64_1D:
    """Return the coefficients of 1, u, v, uu, uv, vv in the sum of the fixed beams, less the error.

    u and v are the shifts, or u is the turn. The error is twice the third-order term of all beams' absolute values, the
    largest of four paths to the edge of the grid.
    """
    rates, out, widest, diagonal = np.empty((6, scan.points.shape[1])), np.zeros(6), 0.0, np.sqrt(0.5)
    at = np.flatnonzero(fixed > 0)
    meets, terms, sums = fixed[at], np.empty((4, len(at))), np.empty(4)
    beams = np.empty((2, len(at)))
    for i in range(len(at)):
        beams[0, i], beams[1, i] = at[i], seen[at[i]] - scan.virtual[at[i]]
    paths = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [diagonal, diagonal, 0.0], [diagonal, -diagonal, 0.0]])
    if window.half_rad > 0.0:
        paths = np.array([[0.0, 0.0, 1.0]])
    for i in range(len(paths)):
        _derive(scan, motion, window, paths[i], work.r, rates)
        _expand(work, beams, meets, rates, terms)
        _sum_up(terms, sums)
        s0, s1, s2, s3 = sums
        out[0], widest = s0, max(widest, s3)
        if i < 2:
            out[1 + i], out[3 + 2 * i] = s1, 0.5 * s2
        else:
            out[4] += 0.5 * s2 if i == 2 else -0.5 * s2
    out[0] -= 2.0 * widest / 6.0 * max(window.half_m, window.half_rad) ** 3
    return out


@helper
def sum_loose(scan: Beams, loose: I64_1D, motion: F64_1D, work: Work) -> tuple[float, float]:
    """Return the sum of the squared differences of loose beams for one candidate, and the number that contribute."""
    virtual, points, limits = scan
    n, total, used = points.shape[1], 0.0, 0.0
    if len(loose) == 0:
        return total, used
    to_polar(points, motion, limits, work.r[:n], work.beam[:n])
    seen = work.seen[: len(virtual)]
    for i in range(len(loose)):
        seen[loose[i]] = np.inf
    span(scan, work)
    lower_ranges(scan, work, seen)
    for i in range(len(loose)):
        at, d = seen[loose[i]], seen[loose[i]] - virtual[loose[i]]
        if limits.near_m < at < limits.far_m and abs(d) < limits.occlusion_m:
            total += d * d
            used += 1.0
    return total, used
