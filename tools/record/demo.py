"""Record a finished `make demo`: result files, pictures and README tables.

Run from the root of the checkout that made it, with what `make demo` printed and `time` measured:

    .venv/bin/python -m tools.record.demo --setup-seconds 95 --total-seconds 830
"""

import argparse
import os
from pathlib import Path

import cv2

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import PROVENANCE, SUMMARY
from nerf_rl.pretrain.measures.figures import NETWORK, describe_error, describe_iou, describe_validation
from nerf_rl.pretrain.reconstructions import newest_reconstruction
from nerf_rl.report.contact_sheet import contact_sheet
from nerf_rl.rl.training.curves import draw_learning_curve
from tools.page_tables import markdown_table, replace_tables
from tools.record import choices

STAGES = {
    "datasets": Path("data/demo"),
    "pretrain": Path("runs/demo/encoder"),
    "rl": Path("runs/demo/agent"),
}


def main() -> None:
    """Copy summaries with their provenance, draw pictures, and rewrite the tables between markers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setup-seconds", type=float, required=True, help="what `make setup` took [s]")
    parser.add_argument("--total-seconds", type=float, required=True, help="what `make demo` took, set-up included [s]")
    times = vars(parser.parse_args())
    results = {}
    for stage, folder in STAGES.items():
        results[stage] = read_result(folder)
        (Path(stage) / "results").mkdir(exist_ok=True)
        write_json(Path(stage) / "results" / "demo.json", results[stage])
    Path("tools/results").mkdir(exist_ok=True)
    made_by = {name: results["rl"]["provenance"][name] for name in ("git_revision", "packages")}
    write_json(Path("tools/results/demo.json"), {"command": "make demo", **times, "cpus": os.cpu_count(), **made_by})
    dataset = MultiViewDataset(STAGES["datasets"])
    sheet = contact_sheet(dataset, [len(dataset) // 3, 2 * len(dataset) // 3])
    cv2.imwrite("datasets/results/contact_sheet.png", sheet[..., ::-1])
    halved = cv2.imread(str(newest_reconstruction(STAGES["pretrain"])))[::2, ::2]  # one pixel each, to stay small
    cv2.imwrite("pretrain/results/reconstruction.png", halved)
    draw_learning_curve(Path("rl/results/demo.png"), results["rl"]["evaluations"], "make demo")
    tables = {
        "demo": demo_table(results, **times),
        "pretrain": pretrain_table(results["pretrain"]),
        "rl": rl_table(results["rl"]),
    }
    for readme in (Path("README.md"), *(Path(stage) / "README.md" for stage in STAGES)):
        write_text(readme, replace_tables(readme.read_text(), tables))
    choices.main()


def read_result(run: Path) -> dict:
    """Return the summary of a finished run, with its provenance."""
    return {**read_json(run / SUMMARY), "provenance": read_json(run / PROVENANCE)}


def demo_table(results: dict, setup_seconds: float, total_seconds: float) -> str:
    """Return the figures of all stages."""
    data, encoder, agent = results["datasets"], results["pretrain"], results["rl"]
    figures, last = encoder["validation"], agent["evaluations"][-1]
    probe = ", ".join(
        f"{name.replace('_', ' ')} {describe_error(figure)}"
        for name, figure in encoder["probe"].items()
        if not name.startswith("goal")
    )
    rows = [
        ("set-up", f"{setup_seconds:.0f} s"),
        ("dataset", f"{data['frames']:,} frames x 4 views of 64 x 64 in {data['seconds']:.0f} s"),
        (
            "encoder",
            f"{encoder['steps']:,} steps in {encoder['seconds']:.0f} s, {encoder['peak_rss_mb']:.0f} MB: "
            f"held-out {describe_validation(figures)}",
        ),
        ("linear probe, RMSE", probe),
        (
            "policy",
            f"{last['success_rate']:.0%} success in {last['episodes']} episodes (95 % interval {last['ci_low']:.0%} to "
            f"{last['ci_high']:.0%}) after {last['env_steps']:,} environment steps, {agent['seconds']:.0f} s, "
            f"{agent['peak_rss_mb']:.0f} MB with its workers",
        ),
        ("all, with the report", f"{total_seconds:.0f} s"),
    ]
    return markdown_table(["stage", "result"], rows)


def pretrain_table(summary: dict) -> str:
    """Return the probes and the classes' IoU."""
    probes = [
        (
            name,
            describe_error(figure),
            describe_error(figure, NETWORK),
            f"{figure['r2']:.3f}",
            describe_error(untrained),
        )
        for kind in ("probe", "joint_probe")
        for name, figure in summary.get(kind, {}).items()
        for untrained in [summary[f"{kind}_random_encoder"][name]]
    ]
    classes = [(name, describe_iou(iou)) for name, iou in summary["class_iou"].items()]
    header = ["state", "linear probe", "network probe", "R2, linear", "untrained encoder, linear"]
    return f"{markdown_table(header, probes)}\n\n{markdown_table(['class', 'IoU'], classes)}"


def rl_table(summary: dict) -> str:
    """Return the evaluations during training."""
    rows = [
        (
            f"{e['env_steps']:,}",
            f"{e['success_rate']:.0%}",
            f"{e['ci_low']:.0%} to {e['ci_high']:.0%}",
            e["episodes"],
            f"{e['mean_return']:.0f}",
        )
        for e in summary["evaluations"]
    ]
    return markdown_table(["environment steps", "success", "95 % interval", "episodes", "mean return"], rows)


if __name__ == "__main__":
    main()
