"""`viscovib.run`: compute a scene at one point or at every point of a grid."""

from __future__ import annotations

import os

from viscovib.common.parameters import Flag
from viscovib.scene.job import SceneResult, run_one
from viscovib.scene.scene import Scene

_PROGRESS = Flag("progress")


def run(scene: Scene | str | os.PathLike[str], *, progress: bool = False) -> SceneResult:
    """Compute a scene; if it has &sweep groups, at every point of their grid.

    Examples
    --------
    >>> import viscovib as vv
    >>> result = vv.run("data/scenes/mount_paper.nml")
    >>> peak = result.response.peak("x")
    """
    _PROGRESS.check(progress)
    read = scene if isinstance(scene, Scene) else Scene.read(scene)
    if read.groups["sweep"]:
        from viscovib.sweeps.sweeping import sweep

        return SceneResult(read, sweep(read, progress=progress, extract="summary"))
    return run_one(read, progress=progress)
