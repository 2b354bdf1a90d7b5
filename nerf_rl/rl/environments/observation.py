"""A frozen encoder's latent as a Gymnasium observation."""

import functools
import multiprocessing
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor

from nerf_rl.cameras.tracking_frame import to_world
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.rendering.following import body_id
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rl.environments.encoder_match import warn_of_other_rendering
from nerf_rl.rl.environments.wrappers import observed_numbers
from nerf_rl.scenes.render_data import RenderData
from nerf_rl.scenes.simulation import simulation_of


class LatentObservation(gymnasium.ObservationWrapper):
    """Replaces an environment's observation by [standardised latent, proprioception], float32.

    The cameras, their resolution, the body that they follow if they do, and the rendering quality are those of the
    encoder's artefact, and they see the state as a dataset shows it: nothing else is needed.

        encoder = Encoder.load("runs/encoder")
        env = LatentObservation(env, encoder, proprio=lambda observation: observation[:4])

    Args:
        env: any environment on MuJoCo, whose model and state :func:`nerf_rl.scenes.simulation.find_simulation` finds.
        encoder: a loaded encoder, or where to load it from.
        proprio: from the environment's observation to what is observed beside the latent [P], such as what the robot
            knows of itself; None for the latent alone.
        device: to move the encoder to; None leaves it where it is. Observations are in the CPU's memory either way.
        blind: see nothing: the latent that is observed is zero, and so are images.

    Attributes:
        last_images: what the cameras saw at the last observation [V, H, W, 3], uint8.
        last_latent: its latent [Z], as the encoder gives it (not standardised).

    Raises:
        UserError: the encoder's cameras follow a body that the environment's model does not have.
    """

    last_images: UInt8[ndarray, "V H W 3"]
    last_latent: Float[ndarray, "Z"]

    def __init__(
        self,
        env: gymnasium.Env,
        encoder: Encoder | str | Path,
        proprio: Callable[[Any], ndarray] | None = None,
        device: torch.device | str | None = None,
        blind: bool = False,
    ):
        super().__init__(env)
        self._blind = blind
        self.encoder = Encoder.load(encoder) if isinstance(encoder, (str, Path)) else encoder
        if device is not None:
            self.encoder.to(device)
        self._proprio = proprio
        self._followed = self._body_in(simulation_of(env).model)
        self._recorded_of: tuple[Encoder, torch.device] | None = None
        self._encode: Callable[[Tensor], Tensor] = self.encoder.encode
        self._renderer: MultiViewRenderer | None = None
        self._rendered: mujoco.MjModel | None = None  # what the renderer was made for
        size = self.encoder.latent_size + (0 if proprio is None else len(proprio(env.observation_space.sample())))
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)

    def observation(self, observation: Any) -> Float[ndarray, "O"]:
        """Look at the scene as it is now and return [latent, proprioception].

        Raises:
            FailureError: proprioception does not have as many numbers as it had, or one that is not finite.
        """
        latent = self.look()
        self.last_latent = latent[0].float().cpu().numpy()
        parts = [self.encoder.standardise(latent)[0].float().cpu().numpy()]
        if self._proprio is not None:
            parts.append(self._proprio(observation))
        return observed_numbers(self, np.concatenate(parts))

    @torch.inference_mode()
    def look(self) -> Float[Tensor, "1 Z"]:
        """Return the latent of the scene as it is now, which is always the mean of all if blind; not standardised."""
        if self._blind:
            rig = self.encoder.rig
            self.last_images = np.zeros((len(rig.names), rig.height, rig.width, 3), np.uint8)
            return self.encoder.latent_mean[None]
        self.last_images = self._render()
        images = torch.from_numpy(self.last_images)[None]
        seeing = self.encoder, self.encoder.latent_mean.device  # either may be another one since the last look
        if self._recorded_of != seeing:
            self._recorded_of, self._encode = seeing, _recorded_encode(self.encoder, images)
        return self._encode(images)

    @property
    def gl_renderer(self) -> str:
        """The name of the OpenGL implementation that renders here."""
        return self._make_renderer().gl_renderer

    def close(self) -> None:
        """Release the renderer and the environment."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().close()

    def _body_in(self, model: mujoco.MjModel) -> int:
        """Return the body that the cameras follow; -1 for none."""
        frame = self.encoder.rig.tracking_frame
        return -1 if frame is None else body_id(model, frame.body, "the encoder's cameras")

    def _make_renderer(self) -> MultiViewRenderer:
        """Return the renderer of the environment's model, which is created late, in the process that renders.

        Environments that randomise what they are made of may compile another model for each episode.
        """
        model = self._drawn.model
        if self._renderer is not None and self._rendered is not model:
            self._renderer.close()
            self._renderer, self._followed = None, self._body_in(model)
        if self._renderer is None:
            rig, self._rendered = self.encoder.rig, model
            sizes, look = (rig.height, rig.width, len(rig.names)), (self.encoder.quality, self.encoder.pixels_per_metre)
            self._renderer = MultiViewRenderer(model, *sizes, *look, colours_only=True)
            if multiprocessing.parent_process() is None:  # a learner tells for its workers
                warn_of_other_rendering(self.encoder.renderer, self.encoder.simulators, self._renderer.gl_renderer)
        return self._renderer

    @functools.cached_property
    def _drawn(self) -> RenderData:
        return RenderData(self.env)

    def _render(self) -> UInt8[ndarray, "V H W 3"]:
        renderer, rig = self._make_renderer(), self.encoder.rig
        data, poses = self._drawn.now(), rig.camera_from_world
        if rig.tracking_frame is not None:
            poses = to_world(poses, rig.tracking_frame.origin(data.xpos[self._followed]))
        return renderer.render_rgb(data, rig.intrinsics, poses)


def _recorded_encode(encoder: Encoder, images: UInt8[Tensor, "1 V H W 3"]) -> Callable[[Tensor], Tensor]:
    """Return what encodes such images as the encoder does, to the last bit, by the operations recorded on these.

    Of a single scene, two fifths of the time are Python's, and recorded operations need none. Weights that change are
    seen by them, too. A GPU's are not recorded, since nobody has tried it. What PyTorch recommends in place of its
    recorder either runs in Python (``torch.export``) or needs a compiler for C++ (``torch.compile``).
    """
    if encoder.latent_mean.device.type != "cpu":
        return encoder.encode
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated", category=FutureWarning)
        warnings.filterwarnings("ignore", category=torch.jit.TracerWarning)  # sizes and cameras are always the same
        recorded: Any = torch.jit.trace_module(encoder, {"encode": images}, check_trace=False)
    return recorded.encode
