"""What is said of scans without odometry is true of their log."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, LogOdometry
from mavnav.slam.methods.registry import make_method
from mavnav.slam.retries.unused_odometry import is_recorded, odometry_advice
from mavnav.slam.track import Track

S = 10**9
SCANS = np.arange(4 * S, 5 * S, S // 10)
TEN_A_SECOND, GAP = np.arange(0, 10 * S, S // 10), np.array((0, S, 9 * S, 10 * S))
PATH = Trajectory.of(TEN_A_SECOND.tolist(), [Pose()] * len(TEN_A_SECOND))


def track(recorded_ns: np.ndarray, odom: str = "auto") -> Track:
    config = Config(odom=odom)
    return Track(lambda: (), config, Motion(0.1), make_method(config), recorded_ns=recorded_ns)


@pytest.mark.parametrize(
    ("recorded_ns", "odom", "advice"),
    [
        (TEN_A_SECOND[:0], "auto", "record odometry"),
        (TEN_A_SECOND[:0], "off", "use --odom auto if the log has odometry"),
        (TEN_A_SECOND, "auto", ""),
        (GAP, "auto", "record odometry for the whole log"),
        (TEN_A_SECOND[:20], "auto", "record odometry for the whole log"),
        (TEN_A_SECOND[:1], "auto", "record odometry for the whole log"),
    ],
    ids=["none", "off", "left out", "gap", "ended", "one pose"],
)
def test_the_advice_fits_the_odometry_of_the_log(recorded_ns: np.ndarray, odom: str, advice: str) -> None:
    assert odometry_advice(track(recorded_ns, odom), SCANS) == advice
    assert is_recorded(track(recorded_ns), SCANS) == (advice == "")


def test_odometry_that_contradicts_is_to_be_corrected() -> None:
    wrong = replace(track(TEN_A_SECOND), log_odometry=LogOdometry(PATH))
    assert odometry_advice(wrong, SCANS) == "correct the odometry"
    used = replace(wrong, motion=Motion(0.1, LogOdometry(PATH).lookup(GOOD_ODOMETRY)))
    assert odometry_advice(used, SCANS) == ""
