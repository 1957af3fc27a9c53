# SPDX-License-Identifier: BSD-3-Clause
"""Targets that read map files: changed bytes, and archives whose contents are changed."""

import io
import json
import sys
import zipfile
from functools import lru_cache
from pathlib import Path
from random import Random
from typing import List

import numpy as np
from support.checkout import CHECKOUT
from support.fuzzing import mutations
from support.fuzzing.rules import outcome_of
from support.fuzzing.runner import Case, Target

from ceiling_dso_ros.slam.builder import SiteBuilder
from ceiling_dso_ros.slam.map_file import HEAD, map_bytes, read_map
from ceiling_dso_ros.slam.site_map import Edge, MapKeyframe, SiteMap

sys.path.insert(0, str(CHECKOUT / "test" / "slam"))

import painted_ceiling as ceiling

KEYFRAMES = 3
NAME = "hall.site"


def targets(folder: Path) -> List[Target]:
    """All of them; they write to a folder."""
    path = folder / NAME

    def make(random: Random) -> Case:
        content = mutated_map(random)

        def act() -> str:
            path.write_bytes(content)
            return outcome_of(lambda: _used(read_map(path)))

        return content, act

    return [Target("map file", 2000, lambda: make)]


def mutated_map(random: Random) -> bytes:
    """The content of a file."""
    content = _map()
    if random.randrange(3) == 0:
        return mutations.mutated_bytes(random, content)
    changed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(changed, "w") as target:
        chosen = random.choice(archive.namelist())
        for name in archive.namelist():
            data = archive.read(name)
            if name == chosen == HEAD and random.randrange(2):
                data = json.dumps(mutations.mutated_tree(random, json.loads(data))).encode()
            elif name == chosen:
                data = mutations.mutated_bytes(random, data)
            target.writestr(name, data)
    return changed.getvalue()


def _used(site: SiteMap) -> object:
    """What is made of a map that was read: a robot begins to map in it."""
    return site, map_bytes(site), SiteBuilder(site.camera, site).site().poses


@lru_cache(maxsize=1)
def _map() -> bytes:
    texture = ceiling.paint(20)
    poses = [np.array([0.4 * i, 0.1, 0.2]) for i in range(KEYFRAMES)]
    keyframes = tuple(MapKeyframe(ceiling.record(texture, pose, i), pose, 0) for i, pose in enumerate(poses))
    motion = np.array([0.4, 0.0, 0.0])
    edges = tuple(Edge(i, i + 1, motion, 1e-6 * np.eye(3), i == 1) for i in range(KEYFRAMES - 1))
    return map_bytes(SiteMap(ceiling.RECORD_CAMERA, keyframes, edges))
