"""``nerf-rl view RUN``: the page of an agent."""

from collections.abc import Callable

import numpy as np
import viser
import viser.uplot

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.datasets.storage.frames import EpisodeColumns
from nerf_rl.rl.config import EYES_OF_CONTROLS, NO_CONTROL
from nerf_rl.viewer.field.field_panel import FieldPanel
from nerf_rl.viewer.newest import NewestOnly
from nerf_rl.viewer.pages.agent import ActedEpisode, Agent
from nerf_rl.viewer.pages.agent_pictures import decode_views, draw_decoded, learning_charts
from nerf_rl.viewer.panels.columns_panel import ColumnsPanel
from nerf_rl.viewer.panels.frusta import add_frustum
from nerf_rl.viewer.playback import Playback


class AgentView:
    """Learning curves, and episodes step by step: what the scene, the cameras and the latent show.

    Args:
        server: to build it on.
        agent: to show.
    """

    def __init__(self, server: viser.ViserServer, agent: Agent):
        self.server, self.agent = server, agent
        self._episode: ActedEpisode | None = None
        self._frusta: list[viser.CameraFrustumHandle] = []
        self._images: dict[str, viser.GuiImageHandle] = {}
        self._worker: NewestOnly[tuple[int, int]] = NewestOnly(self._show)
        gui = server.gui
        self.choice = gui.add_dropdown("Episode", tuple(f"{i}: seed {s}" for i, s in enumerate(agent.seeds)))
        self.step = gui.add_slider("Step", 0, 1, 1, 0)
        self._playback = Playback(gui, self._advance, self._worker.wait)
        self.status = gui.add_markdown("acting the episode ...")
        if agent.policy.spec.control != NO_CONTROL:
            gui.add_markdown(f"A control: {EYES_OF_CONTROLS[agent.policy.spec.control]}.")
        self.field: FieldPanel | None = None
        if agent.field is not None:
            bounds = agent.field.bounds
            with gui.add_folder("What the latent decodes to"):
                self.field = FieldPanel(server, agent.palette, (bounds.near, bounds.far))
        panel = gui.add_panel()
        self._tab = panel.add_tab("Episode", viser.Icon.MOVIE)
        with panel.add_tab("Learning", viser.Icon.CHART_LINE):
            for chart in learning_charts(agent.evaluations(), agent.metrics()):
                gui.add_image(chart, format="png")
        panel.dock_left()
        panel.set_width(430)
        self._plot: ColumnsPanel | None = None
        self._begin_camera()
        self.choice.on_update(lambda _: self._choose())
        self.step.on_update(lambda _: self._order())
        self._order()

    def close(self) -> None:
        """End the threads."""
        self._playback.close()
        self._worker.close()
        if self.field is not None:
            self.field.close()

    def _number(self) -> int:
        return int(self.choice.value.split(":")[0])

    def _choose(self) -> None:
        self.step.value = 0
        self._order()

    def _order(self) -> None:
        self._worker.order((self._number(), int(self.step.value)))

    def _advance(self) -> None:
        self.step.value = (int(self.step.value) + 1) % max(1, len(self._episode or ()))
        self._order()

    def _show(self, place: tuple[int, int], stale: Callable[[], bool]) -> None:
        number, step = place
        self.status.content = "acting the episode ..." if self._episode is None else self.status.content
        episode = self.agent.act(number)
        if episode is not self._episode:
            self._episode = episode
            self.step.max = max(1, len(episode) - 1)
        step = min(step, len(episode) - 1)
        self._show_numbers(episode, step)
        self._put("scene", episode.rollout.view[step])
        if episode.rollout.images is not None:
            self._put("what the encoder's cameras see", np.concatenate(episode.rollout.images[step], axis=1))
            self._show_frusta(episode.rollout.images[step])
        folded = self.agent.folded(episode, step)
        if folded is None or self.field is None or self.agent.encoder is None:
            self.server.scene.set_background_image(episode.rollout.view[step])
            return
        self.field.show(folded)
        decoded = decode_views(folded, self.agent.encoder.rig, stale)
        if decoded is not None:
            self.field.depth_range = self.agent.depth_range(decoded)
            picture = draw_decoded(decoded, self.agent.palette, self.field.depth_range)
            self._put("what the latent decodes to: colours, labels, depth", picture)

    def _show_numbers(self, episode: ActedEpisode, step: int) -> None:
        lines = episode.lines()
        steps = np.arange(len(episode) - 1, dtype=np.float64)
        if self._plot is None:
            with self._tab:
                self._plot = ColumnsPanel(self.server.gui, [name.replace(" ", "_") for name in lines])
        columns = {name.replace(" ", "_"): np.asarray(values, np.float64) for name, values in lines.items()}
        self._plot.show(EpisodeColumns(steps, columns), min(step, len(steps) - 1))
        acted = min(step, len(steps) - 1)
        value = "" if episode.values is None else f", Q {episode.values[acted]:.2f}"
        self.status.content = (
            f"seed {episode.seed}, step **{step}** of {len(episode) - 1}, {episode.rollout.outcome()}; "
            f"reward {episode.rollout.rewards[acted]:.2f}{value}"
        )

    def _put(self, label: str, picture: np.ndarray) -> None:
        if label in self._images:
            self._images[label].image = picture
            return
        with self._tab:
            self._images[label] = self.server.gui.add_image(picture, label=label, format="jpeg", jpeg_quality=90)

    def _show_frusta(self, images: np.ndarray) -> None:
        assert self.agent.encoder is not None
        rig = self.agent.encoder.rig
        for i, name in enumerate(rig.names):
            if len(self._frusta) <= i:
                seen = rig.intrinsics[i], rig.camera_from_world[i], images[i]
                self._frusta.append(add_frustum(self.server, name, "encoder", *seen))
            self._frusta[i].image = images[i]

    def _begin_camera(self) -> None:
        self.server.scene.add_frame("/world", axes_length=0.2, axes_radius=0.004)
        if self.agent.encoder is None or self.agent.field is None:
            return
        centre = np.array(self.agent.field.bounds.centre)
        position = camera_position(self.agent.encoder.rig.camera_from_world[0])
        self.server.initial_camera.position = centre + 1.2 * (position - centre) + np.array([0.0, 0.0, 0.25])
        self.server.initial_camera.look_at = centre
