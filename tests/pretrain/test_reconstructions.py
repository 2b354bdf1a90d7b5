"""Which picture of held-out frames is the newest."""

from pathlib import Path

from nerf_rl.pretrain.reconstructions import FOLDER, newest_reconstruction, picture_name


def test_the_newest_picture_is_that_of_the_latest_step(tmp_path: Path):
    assert newest_reconstruction(tmp_path) is None
    (tmp_path / FOLDER).mkdir()
    for name in ("step_of_mine.png", *map(picture_name, (50, 1_000_000, 999_999))):
        (tmp_path / FOLDER / name).touch()
    assert newest_reconstruction(tmp_path) == tmp_path / FOLDER / "step_1000000.png"
