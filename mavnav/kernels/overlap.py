"""How far two scans that see the same walls lie apart, by the poses that they were given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int64, types

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_I2 = types.Array(int64, 2, "C", readonly=True)


@kernel(float64[:, ::1](_F2, _F2, _I2, _F2, _F1, float64, int64))
def scan_distances(
    ranges_m: NDArray[np.float64],
    poses: NDArray[np.float64],
    pairs: NDArray[np.int64],
    directions: NDArray[np.float64],
    beams: NDArray[np.float64],
    cap_m: float,
    every: int,
) -> NDArray[np.float64]:
    """Measure from the points of one scan of a pair to the nearest points of the other.

    Parameters
    ----------
    ranges_m : (scans, beams), NaN where there is no return
    poses : (scans, 3) map_T_laser, m, m, rad
    pairs : (n, 2) which scans
    directions : (beams, 2) cosines and sines in the laser's frame
    beams : (4,) bearing of the first beam and step in rad, least and greatest range used in m
    cap_m : nothing farther is looked for
    every : only every so many-th point of the first scan is used

    Returns
    -------
    (n, 5): of the points with a neighbour within the cap their number and summed distance (m); of the points that the
    second scan could have seen their number and summed distance, each at most the cap; and the number of all points. A
    point can be seen where the beam that points to it has a return, not nearer than the point less the cap.

    The beams are looked at from the one that points to the point outwards, as long as an end point so far aside could
    be nearer than the nearest so far.
    """
    count = ranges_m.shape[1]
    first, step, near_m, far_m = beams
    turn, centre = round(2.0 * np.pi / abs(step)), first + 0.5 * (count - 1) * step
    aside2 = np.empty(count + 2)  # the squared sine of what lies between the point and beams so many farther on
    for k in range(count + 2):
        aside2[k] = np.sin(min(max(k - 1, 0) * abs(step), 0.5 * np.pi)) ** 2
    out = np.zeros((len(pairs), 5))
    for pair in range(len(pairs)):
        a, b = pairs[pair]
        dx, dy, dyaw = poses[a, 0] - poses[b, 0], poses[a, 1] - poses[b, 1], poses[a, 2] - poses[b, 2]
        cb, sb, ct, st = np.cos(poses[b, 2]), np.sin(poses[b, 2]), np.cos(dyaw), np.sin(dyaw)
        tx, ty = cb * dx + sb * dy, cb * dy - sb * dx
        met = 0
        for i in range(count):
            if not near_m <= ranges_m[a, i] <= far_m:
                continue
            met += 1
            if (met - 1) % every:
                continue
            px, py = ranges_m[a, i] * directions[i, 0], ranges_m[a, i] * directions[i, 1]
            x, y = ct * px - st * py + tx, st * px + ct * py + ty
            r = np.sqrt(x * x + y * y)  # a tenth of what hypot takes
            off = (np.arctan2(y, x) - centre + np.pi) % (2.0 * np.pi) - np.pi
            middle, nearest2 = round(off / step + 0.5 * (count - 1)), cap_m * cap_m
            for k in range(count + 2):
                if r * r * aside2[k] > nearest2:
                    break
                for beam in (middle - k, middle + k + 1):
                    if beam < 0:
                        beam += turn  # noqa: PLW2901
                    elif beam >= count:
                        beam -= turn  # noqa: PLW2901
                    if 0 <= beam < count and near_m <= ranges_m[b, beam] <= far_m:
                        ex = ranges_m[b, beam] * directions[beam, 0] - x
                        ey = ranges_m[b, beam] * directions[beam, 1] - y
                        nearest2 = min(nearest2, ex * ex + ey * ey)
            distance = np.sqrt(nearest2)
            out[pair, 4] += 1
            if nearest2 < cap_m * cap_m:
                out[pair, 0] += 1
                out[pair, 1] += distance
            if 0 <= middle < count and r <= far_m and ranges_m[b, middle] > r - cap_m:
                out[pair, 2] += 1
                out[pair, 3] += distance
    return out
