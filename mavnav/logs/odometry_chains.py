"""Odometry in chains of poses that one vehicle can have taken: what continues no chain is left out.

Odometry restarts, estimators jump to a new position, and two publishers share a topic. Each leaves poses that no wheels
can have reached, while the motion before and after them is right.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory, motions
from mavnav.units import NS, pluralize

Steps = NDArray[np.float64]

SLACK: Final = np.array((0.1, 0.15))
"""Error of a step, m and rad, as quantized encoders and stamps that jitter have it."""

FASTER: Final = 2.0
LEAST: Final = np.array((1.0, 2.0))
"""Ratio of the speed of a step to that before it, and speed, m/s and rad/s, from which any vehicle starts.

It may start from what is usual in the log, too: so odometry in centimeters does not jump where the vehicle sets off.
"""

NEXT: Final = 4
"""Number of poses after one, of which some are of the same publisher."""

BEFORE_S: Final = 0.1
"""Time over which the speed before a step is measured, s."""

CLOSED_S: Final = 1.0
"""Time without a pose after which nothing continues a chain, s."""

MOST_OPEN: Final = 4
"""Number of chains, those that were continued last, that a pose may continue: odometry may jump at every pose."""

MOST_LEFT_OUT: Final = 0.6
"""Largest share of poses that are left out: beyond, the odometry is not what it seems, and stays as it is."""


class LeftOut(Struct, frozen=True):
    """What continues no chain: ``poses`` left out and ``jumps`` bridged, the first ``since_s`` after the start."""

    poses: int
    jumps: int
    since_s: float

    @property
    def text(self) -> str:
        """What the odometry does and what is not used of it, as a warning says it."""
        what = " and ".join(
            pluralize(count, name) for count, name in ((self.jumps, "jump"), (self.poses, "pose")) if count
        )
        return (
            f"the odometry jumps, as after a reset or with two publishers ({what}, the first {self.since_s:.1f} s "
            "after its start); these are left out"
        )


def without_jumps(odom_T_base: Trajectory) -> tuple[Trajectory, LeftOut | None]:
    """Return odometry without jumps and without poses that do not continue the others; None if it has none.

    Of chains at the same time the one with most poses is kept. Chains that follow each other are joined as if the
    motion before the jump went on. Odometry of which too little would be left stays as it is.
    """
    if len(odom_T_base) < 3:
        return odom_T_base, None
    usual = np.maximum(_usual_speeds(odom_T_base), LEAST)
    if not _breaks(odom_T_base, usual).any():
        return odom_T_base, None
    chains = sorted(_longest_apart(list(_chains(odom_T_base, usual))))
    dropped = np.setdiff1d(np.arange(len(odom_T_base)), np.concatenate(chains))
    if len(dropped) > MOST_LEFT_OUT * len(odom_T_base):
        return odom_T_base, None
    firsts = [*dropped[:1].tolist(), *(chain[0] for chain in chains[1:2])]
    since_s = float(odom_T_base.stamps_ns[min(firsts)] - odom_T_base.stamps_ns[0]) * NS
    return _join(odom_T_base, chains), LeftOut(len(dropped), len(chains) - 1, since_s)


def _sizes(odom_T_base: Trajectory, start: NDArray[np.intp], end: NDArray[np.intp]) -> tuple[Steps, Steps]:
    """Return distance and turn (n, 2) between poses, m, rad, and the time between them (n, 1), s."""
    moved = motions(odom_T_base.xyyaw, start, end)
    elapsed_s = (odom_T_base.stamps_ns[end] - odom_T_base.stamps_ns[start]) * NS
    sizes = np.column_stack((np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])))
    return sizes, np.asarray(elapsed_s)[:, None]


def _is_reachable(sizes: Steps, elapsed_s: Steps | float, speeds: Steps) -> NDArray[np.bool_]:
    """Return which steps, (n, 2) m and rad, a vehicle of some speeds before them can make."""
    return np.asarray((sizes <= SLACK + FASTER * speeds * elapsed_s).all(axis=-1))


def _usual_speeds(odom_T_base: Trajectory) -> Steps:
    """Return the speeds, m/s and rad/s, that nine of ten poses do not exceed to the nearest of the next ``NEXT``."""
    ends, rows = len(odom_T_base) - 1, np.arange(len(odom_T_base) - 1)
    steps = [_sizes(odom_T_base, rows, np.minimum(rows + lag, ends)) for lag in range(1, NEXT + 1)]
    return np.asarray(np.quantile(np.min([sizes / elapsed_s for sizes, elapsed_s in steps], axis=0), 0.9, axis=0))


def _breaks(odom_T_base: Trajectory, usual: Steps) -> NDArray[np.bool_]:
    """Return which steps (n - 1,) do not continue the motion before them, nor start with ``usual`` speeds."""
    numbers, stamps_ns = np.arange(len(odom_T_base)), odom_T_base.stamps_ns
    sizes, elapsed_s = _sizes(odom_T_base, numbers[:-1], numbers[1:])
    earlier = np.clip(np.searchsorted(stamps_ns, stamps_ns - round(BEFORE_S / NS)), 0, numbers - 1)[1:-1]
    moved, before_s = _sizes(odom_T_base, earlier, numbers[1:-1])
    speeds = np.vstack((usual, moved / before_s))
    return np.asarray(~_is_reachable(sizes, elapsed_s, np.maximum(speeds, usual)))


def _chains(odom_T_base: Trajectory, usual: Steps) -> Iterator[list[int]]:
    """Yield the chains, as numbers of poses: each pose continues the chain whose end is nearest, if it can."""
    stamps_s = ((odom_T_base.stamps_ns - odom_T_base.stamps_ns[0]) * NS).tolist()
    poses = [odom_T_base[k] for k in range(len(odom_T_base))]
    chains: list[list[int]] = []
    ends: list[list[int]] = []
    for k, pose in enumerate(poses):
        ends = [chain for chain in ends[-MOST_OPEN:] if stamps_s[k] - stamps_s[chain[-1]] <= CLOSED_S]
        steps = [(poses[chain[-1]].gap(pose), chain) for chain in ends]
        fit = []
        for size, chain in steps:
            speed, elapsed_s = _speed(poses, stamps_s, chain, usual), stamps_s[k] - stamps_s[chain[-1]]
            fit += [(size[0], chain)] if _is_reachable(np.array(size), elapsed_s, speed) else []
        if fit:
            nearest = min(fit, key=lambda pair: pair[0])[1]
            nearest.append(k)
            ends = [*(chain for chain in ends if chain is not nearest), nearest]
        else:
            ends.append([k])
            chains.append(ends[-1])
    yield from chains


def _speed(poses: list[Pose], stamps_s: list[float], chain: list[int], usual: Steps) -> Steps:
    """Return the speeds, m/s and rad/s, at the end of a chain, at least ``usual`` ones."""
    last = chain[-1]
    earlier = next((k for k in reversed(chain[-20:-1]) if stamps_s[last] - stamps_s[k] >= BEFORE_S), chain[0])
    if earlier == last:
        return usual
    return np.maximum(np.array(poses[earlier].gap(poses[last])) / (stamps_s[last] - stamps_s[earlier]), usual)


def _longest_apart(chains: list[list[int]]) -> Iterator[list[int]]:
    """Yield the longest chains of those at the same time."""
    taken: list[list[int]] = []
    for chain in sorted(chains, key=len, reverse=True):
        if all(chain[-1] < other[0] or chain[0] > other[-1] for other in taken):
            taken.append(chain)
            yield chain


def _join(odom_T_base: Trajectory, chains: list[list[int]]) -> Trajectory:
    """Return chains in one frame: across each jump the vehicle moved as before it."""
    joined = [Trajectory(odom_T_base.stamps_ns[chains[0]], odom_T_base.xyyaw[chains[0]])]
    for before, chain in pairwise(chains):
        stamps_ns, last = odom_T_base.stamps_ns, joined[-1]
        ahead = Pose()
        if len(before) > 1:
            step_ns, gap_ns = (int(b - a) for a, b in pairwise(stamps_ns[[before[-2], before[-1], chain[0]]]))
            x_m, y_m, yaw_rad = (min(gap_ns / step_ns, 1.0) * part for part in last[-2].between(last[-1]))
            ahead = Pose(x_m, y_m, yaw_rad)
        moved = last[-1] @ ahead @ odom_T_base[chain[0]].inverse()
        joined.append(Trajectory(stamps_ns[chain], odom_T_base.xyyaw[chain]).seen_from(moved))
    return Trajectory(*(np.concatenate([getattr(part, name) for part in joined]) for name in ("stamps_ns", "xyyaw")))
