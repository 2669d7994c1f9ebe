"""MJCF files found and read; what is wrong with one is said in one line."""

from collections.abc import Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import mujoco

EXTRA = "pip install 'zfall[robots]'"  # brings the models of ``recipes/robot``


def find_mjcf(place: str) -> str:
    """Path of an MJCF.

    Args:
        place: of the file; of a folder that holds one robot, as those of MuJoCo's menagerie do; or
            ``PACKAGE:PATH`` inside an installed package, ``dm_control:suite/humanoid.xml``.

    Raises:
        ValueError: if there is none, saying what is there.
    """
    path = Path(place)
    package, colon, inside = place.partition(":")
    if colon and package.isidentifier():
        path = _folder_of(package) / inside
    if path.is_dir():
        return str(_only_robot(path))
    if not path.is_file():
        folder = path.parent
        there = sorted(x.name for x in folder.glob("*.xml")) if folder.is_dir() else []
        raise ValueError(
            f"mjcf must be the path of an MJCF, there is no {path}; "
            f"{folder} has {', '.join(there) or 'none'}."
        )
    return str(path)


def read_spec(path: str) -> mujoco.MjSpec:
    """The spec of an MJCF, in which every link has a name.

    Raises:
        ValueError: if it is none.
    """
    try:
        spec = mujoco.MjSpec.from_file(path)
    except (ValueError, OSError) as error:
        raise ValueError(f"mjcf must be an MJCF, {path} is not: {_in_one_line(error)}") from None
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = f"link_{number}"
    return spec


def compile_spec(spec: mujoco.MjSpec, path: str) -> mujoco.MjModel:
    """The model of a spec.

    Raises:
        ValueError: if it does not compile, because a mesh is missing for instance.
    """
    try:
        return spec.compile()
    except (ValueError, OSError) as error:
        raise ValueError(f"mjcf must compile, {path} does not: {_in_one_line(error)}") from None


def follow(spec: mujoco.MjSpec, kind: mujoco.mjtObj, renamed: Mapping[str, str]) -> None:
    """Has what refers to elements by their names know the new ones; changes the spec.

    Args:
        spec: in which geoms or actuators have been renamed.
        kind: of these.
        renamed: new names by old ones.
    """
    for sensor in spec.sensors:
        if sensor.objtype == kind:
            sensor.objname = renamed.get(sensor.objname, sensor.objname)
        if sensor.reftype == kind:
            sensor.refname = renamed.get(sensor.refname, sensor.refname)
    if kind == mujoco.mjtObj.mjOBJ_GEOM:
        for pair in spec.pairs:
            pair.geomname1 = renamed.get(pair.geomname1, pair.geomname1)
            pair.geomname2 = renamed.get(pair.geomname2, pair.geomname2)
    for group in spec.tuples:
        for number, each in enumerate(group.objtype):
            if each == kind and group.objname[number] in renamed:
                group.objname[number] = renamed[group.objname[number]]


def plain_model(path: str) -> mujoco.MjModel:
    """The model of an MJCF without what is only seen; compiled once, not to be changed.

    Raises:
        ValueError: if it does not compile.
    """
    return _plain(path, Path(path).stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _plain(path: str, written: int) -> mujoco.MjModel:
    spec = read_spec(path)
    spec.compiler.discardvisual = True
    return compile_spec(spec, path)


def _folder_of(package: str) -> Path:
    found = find_spec(package)
    if found is None or found.origin is None:
        raise ValueError(
            f"mjcf must be in a package that is installed, {package} is not: {EXTRA} brings the "
            "models that zfall knows."
        )
    return Path(found.origin).parent


def _only_robot(folder: Path) -> Path:
    """The robot's file in a folder, where scenes that include it may lie, too."""
    files = sorted(folder.glob("*.xml"))
    robots = [path for path in files if not path.name.startswith("scene")]
    named = [path for path in robots if path.stem == folder.name]
    if len(found := named or robots) != 1:
        there = ", ".join(path.name for path in files) or "none"
        raise ValueError(f"mjcf must name one MJCF, {folder} has {there}: name the file.")
    return found[0]


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split())
