"""Poses in the plane: SE(2) composition, and trajectories of them."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

MAX_GAP_NS = 1_000_000_000
"""Longest gap in the poses of a truth, or of another program, over which they are interpolated."""

STEP_M, JITTER_RATIO = 0.05, 3.0
"""Distance that jitter does not reach, and ratio of path to straight line from which a piece of that size is jitter."""


def wrap_angle(yaw_rad: float) -> float:
    """Bring an angle (rad) to [-pi, pi)."""
    return (yaw_rad + pi) % (2.0 * pi) - pi


class Pose(NamedTuple):
    """A rigid motion in the plane: read ``a_T_b`` as the pose of frame b in frame a (REP-103 axes).

    ``x_m`` and ``y_m`` are metres, ``yaw_rad`` radians, counter-clockwise.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``a_T_b @ b_T_c`` is ``a_T_c``."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return Pose(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            wrap_angle(self.yaw_rad + other.yaw_rad),
        )

    def inverse(self) -> Pose:
        """Return ``b_T_a`` of ``a_T_b``."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return Pose(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, wrap_angle(-self.yaw_rad))

    def between(self, other: Pose) -> Pose:
        """Return the pose of ``other`` seen from here: ``self.inverse() @ other``, to the last bit."""
        c, s, back = cos(self.yaw_rad), sin(self.yaw_rad), wrap_angle(-self.yaw_rad)
        x, y = -c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m
        c, s = cos(back), sin(back)
        return Pose(
            x + c * other.x_m - s * other.y_m, y + s * other.x_m + c * other.y_m, wrap_angle(back + other.yaw_rad)
        )

    def gap(self, other: Pose) -> tuple[float, float]:
        """Return how far another pose of the same frame is from here, m, and how far it is turned, rad, 0 or more."""
        away_m = abs(complex(other.x_m - self.x_m, other.y_m - self.y_m))
        return away_m, abs(wrap_angle(other.yaw_rad - self.yaw_rad))

    @property
    def distance_m(self) -> float:
        """Length of the translation."""
        return abs(complex(self.x_m, self.y_m))  # a tenth of what NumPy takes for one number

    def as_array(self) -> NDArray[np.float64]:
        """Return ``[x_m, y_m, yaw_rad]``, shape (3,)."""
        return np.array([self.x_m, self.y_m, self.yaw_rad])  # of the tuple itself it takes longer


def blend(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose that lies the share 0 .. 1 of the way from ``a`` to ``b``, turning the shorter way round."""
    return Pose(
        a.x_m + share * (b.x_m - a.x_m),
        a.y_m + share * (b.y_m - a.y_m),
        wrap_angle(a.yaw_rad + share * wrap_angle(b.yaw_rad - a.yaw_rad)),
    )


def transform_points(a_T_b: Pose, xy_b_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring points (n, 2) in metres from frame b to frame a."""
    c, s = cos(a_T_b.yaw_rad), sin(a_T_b.yaw_rad)
    x, y = xy_b_m[:, 0], xy_b_m[:, 1]
    out = np.empty((len(xy_b_m), 2))  # filled column by column: stacking two takes three times as long
    out[:, 0], out[:, 1] = a_T_b.x_m + c * x - s * y, a_T_b.y_m + s * x + c * y
    return out


def rigid_fit(from_xy_m: NDArray[np.float64], to_xy_m: NDArray[np.float64]) -> Pose:
    """Return the rigid motion that aligns points (n, 2) with their partners by least squares (Umeyama 1991)."""
    a, b = from_xy_m.mean(axis=0), to_xy_m.mean(axis=0)
    p, q = from_xy_m - a, to_xy_m - b
    yaw = float(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))
    turned = transform_points(Pose(0.0, 0.0, yaw), a[None])[0]
    return Pose(float(b[0] - turned[0]), float(b[1] - turned[1]), yaw)


def between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses b in the frames of poses a, (n, 3) each: ``inverse(a) @ b`` row by row, yaw in [-pi, pi)."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy, turn = (b - a).T
    return np.column_stack((c * dx + s * dy, c * dy - s * dx, (turn + pi) % (2.0 * pi) - pi))


def motions(xyyaw: NDArray[np.float64], start: NDArray[np.intp], end: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the motion (m, 3) from poses to poses of (n, 3), in the frame of the first: m, m, rad."""
    return between(xyyaw[start], xyyaw[end])


def nearest_rows(stamps_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the row of the stamp nearest to each wanted time, of two the earlier; ``stamps_ns`` (n,) ascend."""
    after = np.clip(np.searchsorted(stamps_ns, wanted_ns), 0, len(stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(wanted_ns - stamps_ns[before]) <= np.abs(wanted_ns - stamps_ns[after])
    return np.where(nearer, before, after)


class Trajectory(Struct, frozen=True):
    """Poses of one moving frame in one fixed frame, over time.

    ``stamps_ns`` is (n,) int64, strictly ascending; ``xyyaw`` is (n, 3) float64 in m, m, rad.
    Both are read-only.
    """

    stamps_ns: NDArray[np.int64]
    xyyaw: NDArray[np.float64]

    def __repr__(self) -> str:
        """Return the shapes of the arrays, in a line."""
        return f"Trajectory(stamps_ns=int64[{len(self)}], xyyaw=float64[{len(self)}, 3])"

    def __post_init__(self) -> None:
        """Check the shapes and freeze the arrays."""
        if self.stamps_ns.ndim != 1 or self.xyyaw.shape != (len(self.stamps_ns), 3):
            raise ValueError(f"shapes {self.stamps_ns.shape} and {self.xyyaw.shape} are no trajectory")
        self.stamps_ns.flags.writeable = False
        self.xyyaw.flags.writeable = False

    @classmethod
    def of(cls, stamps_ns: list[int], poses: list[Pose]) -> Trajectory:
        """Build from stamps and poses, one each."""
        xyyaw = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in poses], dtype=np.float64)
        return cls(np.array(stamps_ns, dtype=np.int64), xyyaw.reshape(len(poses), 3))

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.stamps_ns)

    def __getitem__(self, index: int) -> Pose:
        """Return one pose."""
        return Pose(*self.xyyaw[index].tolist())

    def at(self, stamp_ns: int, max_gap_ns: int) -> Pose | None:
        """Interpolate the pose at a time; None outside, or in a gap longer than ``max_gap_ns``."""
        k = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if k < len(self) and self.stamps_ns[k] == stamp_ns:
            return self[k]
        if k in (0, len(self)):
            return None
        t0, t1 = int(self.stamps_ns[k - 1]), int(self.stamps_ns[k])
        if t1 - t0 > max_gap_ns:
            return None
        return blend(self[k - 1], self[k], (stamp_ns - t0) / (t1 - t0))

    def poses_at(self, stamps_ns: NDArray[np.int64], max_gap_ns: int) -> NDArray[np.float64]:
        """Interpolate the poses (n, 3) at times (n,); NaN outside, and in gaps longer than ``max_gap_ns``."""
        if not len(self):
            return np.full((len(stamps_ns), 3), np.nan)
        first, last = self.stamps_ns[[0, -1]]
        inside = np.clip(stamps_ns, first, last)
        after = np.searchsorted(self.stamps_ns, inside)
        before = after - (self.stamps_ns[after] > inside)
        since = (inside - first).astype(np.float64), (self.stamps_ns - first).astype(np.float64)
        x, y, yaw = self.xyyaw.T
        out = np.column_stack([np.interp(*since, column) for column in (x, y, np.unwrap(yaw))])
        out[:, 2] = (out[:, 2] + pi) % (2.0 * pi) - pi
        out[(inside != stamps_ns) | (self.stamps_ns[after] - self.stamps_ns[before] > max_gap_ns)] = np.nan
        return out

    def compose(self, b_T_c: Pose) -> Trajectory:
        """Follow another point of the same rigid body: ``a_T_b`` over time gives ``a_T_c``."""
        x, y, yaw = self.xyyaw.T
        c, s = np.cos(yaw), np.sin(yaw)
        x, y = x + c * b_T_c.x_m - s * b_T_c.y_m, y + s * b_T_c.x_m + c * b_T_c.y_m
        yaw = (yaw + b_T_c.yaw_rad + pi) % (2.0 * pi) - pi
        return Trajectory(self.stamps_ns, np.column_stack((x, y, yaw)))

    def seen_from(self, c_T_a: Pose) -> Trajectory:
        """Express in another fixed frame: ``a_T_b`` over time gives ``c_T_b``."""
        return Trajectory.of(self.stamps_ns.tolist(), [c_T_a @ self[k] for k in range(len(self))])

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(np.hypot(*np.diff(self.xyyaw[:, :2], axis=0).T).sum())

    @property
    def travelled_m(self) -> float:
        """Length of the path without the jitter of a body at rest.

        A piece ends where it is `STEP_M` from its start. If it is over `JITTER_RATIO` times as long as the straight
        line between its ends, that line counts. The last piece stays within `STEP_M`: it counts up to a length of
        `JITTER_RATIO` of these.
        """
        total_m = piece_m = 0.0
        xy_m = (self.xyyaw[:, 0] + 1j * self.xyyaw[:, 1]).tolist()
        start = xy_m[0] if xy_m else 0j
        for before, here in pairwise(xy_m):
            piece_m += abs(here - before)
            line_m = abs(here - start)
            if line_m >= STEP_M:
                total_m += piece_m if piece_m <= JITTER_RATIO * line_m else line_m
                start, piece_m = here, 0.0
        return total_m + (piece_m if piece_m <= JITTER_RATIO * STEP_M else 0.0)


def correct_path(
    a_T_b: Trajectory, offset_ns: int, distance_scale: float = 1.0, turn_scale: float = 1.0, veer_rad_m: float = 0.0
) -> Trajectory:
    """Return a path with a time added to its stamps, its distances and turns multiplied, and a turn for each meter.

    It begins at the same pose.
    """
    stamps_ns = a_T_b.stamps_ns + offset_ns
    if not len(a_T_b) or (distance_scale, turn_scale, veer_rad_m) == (1.0, 1.0, 0.0):
        return Trajectory(stamps_ns, a_T_b.xyyaw)
    where, heading_rad = a_T_b.xyyaw[:, 0] + 1j * a_T_b.xyyaw[:, 1], np.unwrap(a_T_b.xyyaw[:, 2])
    moved = np.diff(where) * np.exp(-0.5j * (heading_rad[:-1] + heading_rad[1:]))
    turned = turn_scale * np.diff(heading_rad) + veer_rad_m * moved.real
    yaw_rad = np.cumsum(np.append(heading_rad[0], turned))
    steps = distance_scale * moved * np.exp(1j * (yaw_rad[:-1] + 0.5 * turned))
    xy = np.cumsum(np.append(where[0], steps))
    return Trajectory(stamps_ns, np.column_stack((xy.real, xy.imag, yaw_rad)))


class Rotation(Struct, frozen=True):
    """How a body turned, as an inertial sensor measured it: at stamps (n,), ns, strictly ascending.

    ``yaw_rad`` (n,) is the yaw rate, integrated, not wrapped; ``tilt_rad`` (n,) the angle between the vertical of the
    body and its usual one, 0 or more. All are read-only.
    """

    stamps_ns: NDArray[np.int64]
    yaw_rad: NDArray[np.float64]
    tilt_rad: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.stamps_ns, self.yaw_rad, self.tilt_rad):
            array.flags.writeable = False

    def turned_rad(self, start_ns: int, end_ns: int, max_gap_ns: int) -> float | None:
        """Return the turn about the vertical between two times; None outside, or next to a longer gap than that."""
        ends = np.array((start_ns, end_ns))
        after = np.searchsorted(self.stamps_ns, ends)
        if not (after.min() > 0 and after.max() < len(self.stamps_ns)):
            return None
        gaps_ns = self.stamps_ns[after] - self.stamps_ns[after - 1]
        if gaps_ns.max() > max_gap_ns:
            return None
        share = (ends - self.stamps_ns[after - 1]) / gaps_ns
        first, last = self.yaw_rad[after - 1] + share * (self.yaw_rad[after] - self.yaw_rad[after - 1])
        return float(last - first)

    def tilts_rad(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the tilt at other stamps (m,): 0 where it is not known."""
        since = (stamps_ns - self.stamps_ns[0], self.stamps_ns - self.stamps_ns[0])
        return np.asarray(np.interp(*since, self.tilt_rad, left=0.0, right=0.0))


def ups_of_quaternions(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the upward direction in the frame of a body, (n, 3), of its orientations (n, 4); NaN where it is none."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x, y, z, w = (xyzw / np.linalg.norm(xyzw, axis=1, keepdims=True)).T
        return np.column_stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))


def yaw_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw (rad) of a quaternion of any length, the rotation about z in Z-Y-X order (REP-103)."""
    return atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
