"""Write the tables of datasets/README.md from the results of its benchmarks, and those of docs/choosing.md.

Run from a checkout's root:

    .venv/bin/python -m tools.record.dataset_speed
"""

from pathlib import Path

from nerf_rl.files.json_files import read_json
from tools.page_tables import markdown_table, write_tables
from tools.record import choices

RESULTS, README = Path("datasets/results"), Path("datasets/README.md")


def main() -> None:
    """Rewrite the tables between markers."""
    tables = {
        "render": render_table(read_json(RESULTS / "render.json")),
        "generation": generation_table(read_json(RESULTS / "generation.json")),
        "reading": reading_table(read_json(RESULTS / "reading.json")),
        "view": view_table(read_json(RESULTS / "view.json")),
    }
    write_tables(README, tables)
    choices.main()


def render_table(result: dict) -> str:
    """Return a row for each way to render."""
    times = result["milliseconds_per_view"]
    near = {
        name: f"{value:.1f} dB against the mean of 64 colours" for name, value in result["psnr_db_of_means"].items()
    }
    meshes = f"mask IoU {result['mask_iou']:.3f} and {result['rgb_psnr_db']:.1f} dB against full meshes"
    rows = [
        ("MuJoCo's renderer", f"{times['stock']:.1f}", "1", ""),
        ("ours, full meshes", f"{times['plain']:.1f}", f"{result['ratio_full_mesh']:.1f}", near["plain"]),
        ("ours, `smooth`", f"{times['smooth']:.1f}", f"{result['ratio_smooth']:.1f}", near["smooth"]),
        ("ours, `fast`", f"{times['fast']:.1f}", f"{result['ratio']:.1f}", f"{near['fast']}; {meshes}"),
    ]
    return markdown_table(["way", "ms a view", "times as fast", "what it shows"], rows)


def generation_table(result: dict) -> str:
    """Return the one row of a whole generation."""
    size, workers = result["keys"]["size"], result["keys"]["workers"]
    row = (
        f"{result['frames']:,} x {result['views_per_frame']}, {size} x {size}",
        f"{workers}",
        f"{result['seconds']:.0f} s",
        f"{result['views_per_second']:.0f}",
        f"{result['worker_peak_rss_mb']:.0f} MB",
    )
    return markdown_table(["frames x views", "workers", "time", "views/s", "most memory of a worker"], [row])


def reading_table(result: dict) -> str:
    """Return a row for each figure."""
    loader, sizes, playback = result["loader"], result["by_apparent_size"], result["playback"]
    views, height, width = playback["views_height_width"]
    rows = [
        (
            "reading within a step of `make demo`'s pretraining",
            f"{loader['reading_ms']:.1f} of {loader['step_ms']:.0f} ms ({loader['reading_share_of_step']:.1%}); "
            f"with drawing rays {loader['batch_share_of_step']:.1%}",
        ),
        *(
            (
                f"a dataset of {size} in {figures['shards']:,} shards",
                f"opens in {figures['open_ms']:.0f} ms, a frame at random takes {figures['random_frame_ms']:.2f} ms, "
                f"{figures['memory_after_all_shards_mb']:.0f} MB of memory; "
                f"`nerf-rl view` serves it after {figures['view_seconds']['all']:.1f} s",
            )
            for size, figures in sizes.items()
        ),
        (
            f"what the viewer shows of a frame, {views} views of {height} x {width}",
            f"{playback['frames_per_second']:.0f} frames/s",
        ),
    ]
    return markdown_table(["what", "figure"], rows)


def view_table(result: dict) -> str:
    """Return a row for each figure of the viewer in a browser."""
    dragged = result["field_while_dragging"]
    rows = [
        ("a dataset's first picture after the command", f"{result['dataset']['first_picture_median_s']:.1f} s"),
        ("an encoder's", f"{result['encoder']['first_picture_median_s']:.1f} s"),
        ("a dataset played as fast as it goes", f"{result['scrubbing']['frames_per_second']:.1f} frames/s"),
        (
            "the live field while the camera is dragged, 128 pixels on the longer side, "
            f"{min(dragged['samples_a_ray'])} to {max(dragged['samples_a_ray'])} samples a ray",
            f"{dragged['median_ms']:.0f} ms, {dragged['pictures_per_second_seen']:.1f} pictures/s",
        ),
    ]
    return markdown_table(["what", "figure"], rows)


if __name__ == "__main__":
    main()
