"""Transforms between frames on the plane, as of /tf and /tf_static."""

import bisect
import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np


class PlanarPose(NamedTuple):
    """A pose on the plane."""

    x: float  # m
    y: float  # m
    yaw: float  # rad

    def then(self, inner: "PlanarPose") -> "PlanarPose":
        """A pose in the frame of this pose, in this pose's parent frame."""
        cosine = math.cos(self.yaw)
        sine = math.sin(self.yaw)
        x = self.x + cosine * inner.x - sine * inner.y
        y = self.y + sine * inner.x + cosine * inner.y
        return PlanarPose(x, y, self.yaw + inner.yaw)

    def turn(self, x: float, y: float) -> tuple[float, float]:
        """A vector of the frame of this pose, in this pose's parent frame."""
        turned = PlanarPose(0.0, 0.0, self.yaw).then(PlanarPose(x, y, 0.0))
        return turned.x, turned.y


NOWHERE = PlanarPose(0.0, 0.0, 0.0)


class Transforms:
    """The transforms of /tf and /tf_static on the plane."""

    def __init__(self) -> None:
        """Begin without transforms; ``add`` adds them."""
        self.parent: dict[str, str] = {}
        self._times: dict[str, list[int]] = defaultdict(list)
        self._poses: dict[str, list[PlanarPose]] = defaultdict(list)

    def add(self, parent: str, child: str, time: int, pose: PlanarPose) -> None:
        """Add the pose of a frame in its parent's, at a time [ns]."""
        self.parent[child] = parent
        self._times[child].append(time)
        self._poses[child].append(pose)

    def sort(self) -> None:
        """Put the transforms into the order of time."""
        for child, times in self._times.items():
            order = np.argsort(times, kind="stable")
            self._times[child] = [times[k] for k in order]
            self._poses[child] = [self._poses[child][k] for k in order]

    def root(self, frame: str) -> str:
        """The frame at the end of the parents of a frame."""
        visited = {frame}  # a bag may have frames in a circle
        while frame in self.parent and self.parent[frame] not in visited:
            frame = self.parent[frame]
            visited.add(frame)
        return frame

    def pose(self, frame: str, time: int) -> PlanarPose:
        """The pose of a frame in its root, by the last transforms until a time [ns], or else the first ones."""
        pose = NOWHERE
        visited: set[str] = set()  # a bag may have frames in a circle
        while frame in self.parent and frame not in visited:
            visited.add(frame)
            index = max(0, bisect.bisect_right(self._times[frame], time) - 1)
            pose = self._poses[frame][index].then(pose)
            frame = self.parent[frame]
        return pose

    def times(self, frame: str) -> list[int]:
        """The times [ns] of the transforms of a frame."""
        return self._times.get(frame, [])
