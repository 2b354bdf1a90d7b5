"""``nerf-rl report``: an agent, and its encoder and dataset where it has them, on one self-contained page."""

import shlex
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import OutputExistsError
from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import PROVENANCE, making, require_file_place
from nerf_rl.machine.threads import wait_passively
from nerf_rl.pictures.page import Page
from nerf_rl.pretrain.measures.figures import NETWORK, describe_error, describe_iou, describe_validation
from nerf_rl.pretrain.model.encoder_file import described_classes, read_description
from nerf_rl.pretrain.reconstructions import newest_reconstruction
from nerf_rl.report.config import ReportConfig
from nerf_rl.report.sources import FIELD, Sources, find_sources
from nerf_rl.report.summaries import read_summary
from nerf_rl.rl.config import EYES_OF_CONTROLS, NO_CONTROL, RANDOM
from nerf_rl.rl.training.evaluation_results import (
    HIGH,
    LOW,
    SUCCESS,
    describe_episodes,
    tells_success,
    with_demonstrations,
)

if TYPE_CHECKING:
    from nerf_rl.rl.rollout import Rollout

_FRAMES_PER_SECOND = 12.0
_TITLES = {"data": "dataset", "encoder": "encoder", "agent": "policy"}


def write_report(config: ReportConfig) -> None:
    """Write the page and print its key figures.

    Raises:
        UserError: the agent, or a part that was named, is missing or unfinished; parts are of different scenes, or the
            encoder is not the agent's; the page exists.
    """
    out = Path(config.out)
    if out.exists() and not config.overwrite:
        raise OutputExistsError(out, "use --overwrite true or another --out")
    require_file_place(out)
    sources = find_sources(config)
    summaries = {name: read_summary(name, folder) for name, folder in sources.folders.items()}
    wait_passively()

    marked = "" if sources.control == NO_CONTROL else f" (control: {sources.control})"
    drawing = _drawing(sources)
    page = Page(f"{sources.scene}: {', '.join(_TITLES[name] for name in summaries)}{marked}")
    lines = _key_figures(summaries)
    if sources.control != NO_CONTROL:
        lines.append(f"control  {sources.control}: {EYES_OF_CONTROLS[sources.control]}")
    page.preformatted("\n".join(lines))
    if sources.dataset is not None:
        _add_dataset(page, sources.dataset)
    if "encoder" in summaries:
        _add_encoder(page, sources.folders["encoder"], summaries["encoder"])
    _add_agent(page, config, sources, summaries["agent"], *drawing)
    page.heading("How it was made")
    for folder in sources.folders.values():
        page.preformatted(_made(folder))
    with making(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, page.render())
    print("\n".join([*lines, f"report: {out}"]))


def _key_figures(summaries: dict[str, dict[str, Any]]) -> list[str]:
    lines = []
    if data := summaries.get("data"):
        lines.append(
            f"dataset  {data['frames']} frames, {data['views']} views in {data['seconds']:.0f} s "
            f"({data['views_per_second']:.0f} views/s, {data['renderer']})"
        )
    if encoder := summaries.get("encoder"):
        probe = encoder["probe"].items()
        lines.append(
            f"encoder  {encoder['steps']} steps in {encoder['seconds']:.0f} s: held-out "
            f"{describe_validation(encoder['validation'])}"
        )
        for role, figures in encoder.get("validation_other_cameras", {}).items():
            lines.append(f"         from {role} cameras: {describe_validation(figures)}")
        lines.append("probe    " + ", ".join(f"{name} {describe_error(figure)}" for name, figure in probe))
    agent = summaries["agent"]
    last = agent["evaluations"][-1]
    lines.append(
        f"policy   {describe_episodes(last)} after {last['env_steps']} environment steps in {agent['seconds']:.0f} s"
    )
    return lines


def _add_dataset(page: Page, dataset: MultiViewDataset) -> None:
    from nerf_rl.report.contact_sheet import contact_sheet

    page.heading("Dataset")
    names = ", ".join(dataset.camera_names)
    frames = np.linspace(0, len(dataset) - 1, 6).astype(int)[1:-1].tolist()
    for pair in (frames[:2], frames[2:]):
        caption = f"Colours, labels and depth of two frames; cameras: {names}."
        page.image(contact_sheet(dataset, pair), caption)
    page.legend(dataset.class_names, dataset.palette)


def _add_encoder(page: Page, folder: Path, summary: dict[str, Any]) -> None:
    page.heading("Encoder")
    picture = newest_reconstruction(folder)
    if picture is not None:
        caption = (
            "Held-out frames from the encoder's cameras: what they saw (upper row of each pair) and what the radiance "
            "field renders from the latent alone (lower row). Colours, labels, depth."
        )
        page.image(picture.read_bytes(), caption)
    page.table(["class", "IoU"], [[name, describe_iou(iou)] for name, iou in summary["class_iou"].items()])
    page.paragraph(
        "What a linear map, and what a small network, reads from the latent on held-out episodes, as root mean squared "
        "error:"
    )
    rows = []
    for kind in ("probe", "joint_probe"):
        for name, figure in summary.get(kind, {}).items():
            untrained = summary.get(f"{kind}_random_encoder", {}).get(name, {})
            errors = [describe_error(each, probe) for each in (figure, untrained) for probe in ("", NETWORK)]
            rows.append([name, f"{figure['r2']:.3f}", *errors])
    encoders = [
        f"{probe}, {encoder}" for encoder in ("this encoder", "untrained one") for probe in ("linear", "network")
    ]
    page.table(["state", "R2, linear", *encoders], rows)


def _add_agent(
    page: Page,
    config: ReportConfig,
    sources: Sources,
    summary: dict[str, Any],
    draw: "Callable[[Rollout], ndarray]",
    shown: str,
) -> None:
    from nerf_rl.pictures.video import write_mp4
    from nerf_rl.rl.rollout import rollout
    from nerf_rl.rl.training.curves import draw_learning_curve
    from nerf_rl.rl.training.episodes import evaluation_seeds

    page.heading("Policy")
    if sources.control != NO_CONTROL:
        shown = f"The policy is a control, {EYES_OF_CONTROLS[sources.control]}. {shown}"
    clips, outcomes = [], []
    seeds = evaluation_seeds(config.seed, config.episodes)
    for seed in seeds:
        episode = rollout(config.agent, seed, config.encoder)
        outcomes.append(episode.outcome())
        clips.append(draw(episode))
    with TemporaryDirectory() as scratch:
        write_mp4(Path(scratch) / "clip.mp4", np.concatenate(clips), _FRAMES_PER_SECOND)
        draw_learning_curve(Path(scratch) / "curve.png", summary["evaluations"], "")
        of_seeds = "Episode of seed" if len(seeds) == 1 else "Episodes of seeds"
        caption = f"{of_seeds} {', '.join(map(str, seeds))} ({', '.join(outcomes)}). {shown}"
        page.clip((Path(scratch) / "clip.mp4").read_bytes(), caption)
        intervals = ", with 95 % intervals" if tells_success(summary["evaluations"]) else ""
        page.image((Path(scratch) / "curve.png").read_bytes(), f"Evaluations during training{intervals}.")
    told = tells_success(summary["evaluations"])
    rows = []
    for e in summary["evaluations"]:
        success = [f"{e[SUCCESS]:.0%}", f"{e[LOW]:.0%} to {e[HIGH]:.0%}"] if told else []
        rows.append([str(e["env_steps"]), *success, f"{e['mean_return']:.4g}", str(e["episodes"])])
    if shown := with_demonstrations(summary["evaluations"][-1], "Trained "):
        page.paragraph(f"{shown} of the task's scripted policy, whose environment steps are counted.")
    page.table(["environment steps", *(["success", "95 % interval"] if told else []), "mean return", "episodes"], rows)


def _drawing(sources: Sources) -> "tuple[Callable[[Rollout], ndarray], str]":
    """Return what draws an episode, and a sentence on what is to be seen."""
    from nerf_rl.rl.rollout import film

    if sources.agents_encoder is None:
        return film, "The scene; the policy observes its true state, and no image."
    folder, _ = read_description(sources.agents_encoder)
    if sources.control == RANDOM or not (folder / FIELD).is_file():  # no field is of an untrained encoder's latents
        return film, "Left: the scene. Right: what the encoder's cameras see."
    from nerf_rl.pretrain.model.encoder import Encoder
    from nerf_rl.pretrain.model.field import RadianceField
    from nerf_rl.report.decoded_rollout import decoded_clip

    rig, field = Encoder.load(sources.agents_encoder).rig, RadianceField.load(folder)
    palette = np.array(described_classes(folder)[1], np.uint8)

    def draw(episode: "Rollout") -> ndarray:
        assert episode.images is not None and episode.latents is not None  # the agent has an encoder
        return decoded_clip(episode.view, episode.images, episode.latents, field, rig, palette)

    return draw, (
        f"Left: the scene. Middle: camera '{rig.names[0]}' above what the field decodes from the latent. "
        "Right: decoded labels above decoded depth."
    )


def _made(folder: Path) -> str:
    """Return the command, revision and versions behind a folder."""
    try:
        record = read_json(folder / PROVENANCE)
        versions = " ".join(f"{name}=={version}" for name, version in record["packages"].items())
        command = shlex.join(["nerf-rl", *record["arguments"]])
        return f"{command}\n  revision {record['git_revision']}, seed {record['seed']}\n  {versions}"
    except (OSError, ValueError, LookupError, TypeError, AttributeError):  # none there, or damaged
        return f"{folder}: unknown"
