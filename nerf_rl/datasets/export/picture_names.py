"""Names of the files of cameras' pictures: those of the cameras, unless a file would not lie where it belongs."""

import re
from collections.abc import Sequence
from pathlib import PureWindowsPath

ENDING = ".png"
_LONGEST = 200  # bytes; file systems take 255, with the ending and what marks a file that is being written


def picture_names(cameras: Sequence[str]) -> list[str]:
    """Return a path for each camera's pictures, below the folder of their kind and without its ending.

    Names of cameras may come from anybody's dataset. One that is a path below a folder stays as it is; of another one,
    such as ``../../left``, the letters and digits stay. No two are alike.

    Args:
        cameras: their names.
    """
    taken = {name for name in cameras if _is_below(name)}
    names: list[str] = []
    for camera in cameras:
        if camera in taken and camera not in names:
            names.append(camera)
            continue
        safe = re.sub(r"[^A-Za-z0-9_-]+", "_", camera).strip("_")[:_LONGEST] or "camera"
        number = 1
        while (name := safe if number == 1 else f"{safe}_{number}") in taken:
            number += 1
        taken.add(name)
        names.append(name)
    return names


def _is_below(name: str) -> bool:
    """Tell whether a name leads to a place below a folder, on any system, and past no picture on the way there."""
    *folders, file = name.split("/")
    return (
        not {"", ".", ".."} & {*folders, file}
        and not any(folder.endswith(ENDING) for folder in folders)
        and "\\" not in name
        and not PureWindowsPath(name).drive
        and len(name.encode()) <= _LONGEST
    )
