"""JSON with a checksum of itself: any changed byte is found."""

from pathlib import Path

import numpy as np

from nerf_rl.files.checksummed_json import is_whole, with_checksum, write_checksummed

CONTENT = {"name": "drawer", "far": 0.1, "shards": [{"file": "a", "frames": 3}], "none": None}


def test_a_sealed_file_is_whole_and_any_other_byte_anywhere_is_found(tmp_path: Path):
    path = tmp_path / "a.json"
    write_checksummed(path, CONTENT)
    text, rng = path.read_bytes(), np.random.default_rng(0)
    assert is_whole(path)
    for place in range(len(text)):
        changed = bytearray(text)
        changed[place] ^= int(rng.integers(1, 256))
        path.write_bytes(changed)
        assert not is_whole(path), place


def test_a_file_that_is_cut_longer_missing_or_no_mapping_is_not_whole(tmp_path: Path):
    path = tmp_path / "a.json"
    assert not is_whole(path)
    write_checksummed(path, CONTENT)
    text = path.read_bytes()
    for other in (b"", text[:-1], text + b" ", b"[]\n", b"7"):
        path.write_bytes(other)
        assert not is_whole(path)


def test_a_checksum_of_what_has_one_replaces_it():
    assert with_checksum(with_checksum(CONTENT)) == with_checksum(CONTENT) != with_checksum({**CONTENT, "far": 0.2})
