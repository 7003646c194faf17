"""The map of a group of sessions, as others are searched in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.loop_closure.key_frames import KeyFrameMap, Visibility
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.config.models import Config
    from mavnav.slam.loop_closure.key_frames import KeyFrame

STILL_M, STILL_RAD = 0.03, 0.3 * DEG
"""A map stays where no key frame moved nor turned farther: places are found in it, and measured elsewhere."""


class GroupMap:
    """What some key frames saw: the map of all, and which of them saw which squares of the plane."""

    def __init__(self, keys: Sequence[KeyFrame], config: Config) -> None:
        """Draw the map of some key frames."""
        self.keys, self.map, self.config = list(keys), KeyFrameMap(config), config
        self.seen = Visibility(self.keys)
        self.map.grow(self.keys, len(self.keys))
        self.seen.grow(len(self.keys))

    def with_keys(self, keys: Sequence[KeyFrame]) -> GroupMap:
        """Return the map of more key frames, of which these are the first: this one grown, or another if they moved."""
        count = len(self.keys)
        poses = (np.array([key.map_T_laser for key in some]) for some in (self.keys, keys[:count]))
        off = np.abs(np.subtract(*poses))
        off[:, 2] = np.minimum(off[:, 2], 2.0 * np.pi - off[:, 2])
        if (off > (STILL_M, STILL_M, STILL_RAD)).any():
            return GroupMap(keys, self.config)
        self.keys.extend(keys[count:])
        self.map.grow(self.keys, len(keys))
        self.seen.grow(len(keys))
        return self
