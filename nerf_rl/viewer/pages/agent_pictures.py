"""Pictures of an agent: learning curves with intervals, and what its latent decodes to."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.pictures.images import colour_depth, colour_labels
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.rl.config import EYES_OF_CONTROLS, NO_CONTROL
from nerf_rl.rl.training.curves import draw_returns, draw_success
from nerf_rl.rl.training.evaluation_results import tells_success
from nerf_rl.viewer.drawing.charts import lines_chart, rasterise
from nerf_rl.viewer.drawing.pictures import caption, magnify, side_by_side, stack
from nerf_rl.viewer.drawing.slides import Slide
from nerf_rl.viewer.field.reconstruction import render_views
from nerf_rl.viewer.pages.agent import ActedEpisode, Agent

_PROGRESS = ("episode_return", "episode_success", "q", "td_error", "critic_loss", "pre_tanh", "noise")
_SIGNS_OF_DEADLOCK = ("saturated", "dead_units", "action_gradient", "priority_spread", "stuck_for")


def learning_charts(evaluations: list[dict[str, Any]], metrics: dict[str, ndarray]) -> list[UInt8[ndarray, "_ _ 3"]]:
    """Return charts of what there is: evaluations with 95 % intervals, training's progress, signs of a deadlock."""
    charts = []
    if evaluations:
        charts.append(_evaluation_chart(evaluations))
    for names in (_PROGRESS, _SIGNS_OF_DEADLOCK):
        shown = {name: metrics[name] for name in names if name in metrics and not np.isnan(metrics[name]).all()}
        if shown:
            charts.append(lines_chart(shown, "environment steps", x=metrics["env_steps"]))
    return charts


def decode_views(
    field: ConditionedField, rig: EncoderRig, stale: Callable[[], bool] = lambda: False
) -> list[RenderedImages] | None:
    """Return what a field renders for each of the encoder's cameras; None if a newer picture is wanted before."""
    return render_views(field, rig.intrinsics, rig.camera_from_world, (rig.height, rig.width), stale)


def draw_decoded(
    rendered: Sequence[RenderedImages], palette: UInt8[ndarray, "C 3"], depth_range: tuple[float, float]
) -> UInt8[ndarray, "A B 3"]:
    """Return rows of colours, labels and depth of decoded cameras."""
    colours = [(255 * view.rgb[0]).round().astype(np.uint8) for view in rendered]
    labels = [colour_labels(view.semantic[0], palette) for view in rendered]
    depth = [colour_depth(view.depth[0], *depth_range) for view in rendered]
    return stack([side_by_side(row, 112) for row in (colours, labels, depth)])


def _evaluation_chart(evaluations: list[dict[str, Any]]) -> UInt8[ndarray, "A B 3"]:
    from matplotlib.figure import Figure  # takes half a second to import

    figure = Figure(figsize=(4.4, 3.6), dpi=100, layout="constrained")
    told = tells_success(evaluations)
    axes = figure.subplots(1 + told, 1, sharex=True, squeeze=False)[:, 0]
    if told:
        draw_success(axes[0], evaluations)
        axes[0].set(xlabel="", title="evaluations, 95 % interval")
    draw_returns(axes[-1], evaluations)
    return rasterise(figure)


def episode_slide(agent: Agent, episode: ActedEpisode, step: int) -> Slide:
    """Return one step as a slide: the scene, the encoder's cameras above what their latent decodes to, and numbers."""
    r = episode.rollout
    parts = []
    if r.images is not None:
        rows = [side_by_side(list(r.images[step]), 112)]
        folded = agent.folded(episode, step)
        if folded is not None and agent.encoder is not None:
            decoded = decode_views(folded, agent.encoder.rig)
            assert decoded is not None  # nothing newer is ever wanted here
            rows.append(draw_decoded(decoded, agent.palette, agent.depth_range(decoded)))
        parts.append(stack(rows))
    parts.insert(0, magnify(r.view[step], parts[0].shape[0] if parts else 360))
    height = max(part.shape[0] for part in parts)
    padded = [np.pad(p, ((0, height - p.shape[0]), (0, 8), (0, 0)), constant_values=255) for p in parts]
    picture = np.concatenate(padded, axis=1)
    lines, control = [_numbers(episode, step)], agent.policy.spec.control
    if control != NO_CONTROL:
        lines.append(f"control: {EYES_OF_CONTROLS[control]}")
    captions = [caption(line, picture.shape[1]) for line in lines]
    return Slide(stack([picture, *captions]), f"seed {episode.seed}{'' if len(lines) == 1 else f', {lines[-1]}'}")


def _numbers(episode: ActedEpisode, step: int) -> str:
    acted = min(step, len(episode.rollout.rewards) - 1)
    value = "" if episode.values is None else f"   Q {episode.values[acted]:.2f}"
    solved = episode.rollout.success
    success = "   SUCCESS" if step > 0 and solved is not None and solved[:step].any() else ""
    actions = " ".join(f"{a:+.2f}" for a in episode.rollout.actions[acted])
    return f"step {step}   reward {episode.rollout.rewards[acted]:.2f}{value}   action {actions}{success}"
