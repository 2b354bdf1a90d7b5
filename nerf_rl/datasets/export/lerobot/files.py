"""Where things are in a LeRobotDataset, and files of limited size that hold some episodes each."""

from pathlib import Path

CHUNK = 1000
"""files in a folder"""
MOST_DATA_MB, MOST_VIDEO_MB = 100, 200
"""sizes beyond which a new file is begun [MB]"""
MOST_SECONDS = 500
"""length beyond which a new file is begun [s]: LeRobot finds a picture by its time, as seconds in single precision that
must be right to 1e-4, and beyond 1024 s they are rounded to more than that"""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA = f"data/{_FILE}.parquet"
VIDEO = f"videos/{{video_key}}/{_FILE}.mp4"
LABELS = f"labels/{{video_key}}/{_FILE}.mp4"
EPISODES = f"meta/episodes/{_FILE}.parquet"
TASKS, INFO, STATS, CAMERAS = "meta/tasks.parquet", "meta/info.json", "meta/stats.json", "meta/cameras.json"


def place(number: int) -> dict[str, int]:
    """Return the chunk and the file of the file with a number, counted from 0."""
    return {"chunk_index": number // CHUNK, "file_index": number % CHUNK}


def file_path(folder: Path, pattern: str, number: int, key: str = "") -> Path:
    """Return where the file with a number is."""
    return folder / pattern.format(video_key=key, **place(number))
