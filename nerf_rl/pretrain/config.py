"""What pretraining is made of: encoder, radiance field, sampling, losses, optimisation."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from nerf_rl.arguments.limits import require_most, require_seed
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.loggers import TENSORBOARD, check_loggers
from nerf_rl.machine.devices import check_device_name
from nerf_rl.pretrain.stopping import parse_goal

TEACHERS = ("depth", "normals")
_MOST_IN_A_PLANE = 2**27
PRECISIONS = ("auto", "32", "bf16")
ACCELERATORS = ("auto", "cpu", "gpu")
STRATEGIES = ("auto", "ddp")
FIELD, RANDOM = "field", "random"
OBJECTIVES = (FIELD, "autoencoder", "depth", "masked", "contrastive", "supervised", RANDOM)
_HOW_NOT_WHAT = "data out resume overwrite threads loader_workers steps max_minutes accelerator devices nodes strategy"
_HOW_NOT_WHAT += " log_every loggers stop_when"


@dataclass
class EncoderConfig:
    """The multi-view encoder z = h(mean_i g(CNN(o_i), K_i))."""

    latent: int = 128
    """size of z"""
    patch: int = 4
    """the first convolution reads patches of this size, without overlap [pixels]"""
    channels: list[int] = field(default_factory=lambda: [48, 96, 128])
    """of the convolutions; each after the first halves the image"""
    hidden: int = 256
    """width of g and h"""

    def __post_init__(self) -> None:
        require_most(self, "encoder.", latent=2**14, hidden=2**14, patch=2**12, channels=2**12)
        if not self.channels or min(self.latent, self.hidden, self.patch, *self.channels) < 1:
            raise UserError("encoder.latent, hidden, patch and channels must be positive")


@dataclass
class FieldConfig:
    """The latent-conditioned radiance field: static feature planes beside a network that sees z."""

    width: int = 128
    """of the network and of the features that are composited along a ray"""
    layers: int = 3
    """hidden layers"""
    frequencies: int = 6
    """octaves of the positional encoding"""
    free_frames: int = 4
    """frames with origins linear in z, in which points are encoded as well, beside one for each class that moves"""
    plane_size: int = 128
    """cells along an edge of the three static feature planes"""
    plane_features: int = 8
    """features in a cell"""

    def __post_init__(self) -> None:
        require_most(self, "radiance_field.", width=2**13, layers=64, frequencies=64, plane_size=2**12)
        require_most(self, "radiance_field.", plane_features=2**10, free_frames=2**10)
        if self.plane_size**2 * self.plane_features > _MOST_IN_A_PLANE or self.free_frames < 0:
            raise UserError("radiance_field: planes have at most 2^27 values each, and free_frames is 0 or more")
        if min(self.width, self.layers, self.plane_size, self.plane_features) < 1 or self.frequencies < 0:
            raise UserError(
                "radiance_field.width, layers, plane_size and plane_features must be positive, frequencies 0 or more"
            )


@dataclass
class SamplingConfig:
    """Where rays are evaluated."""

    near: float | None = None
    """nearest planar depth [m]; from the data's depth if null"""
    far: float | None = None
    """depth beyond which everything is one backdrop [m]; from the data's depth if null"""
    training_stratified: int = 4
    """samples a training ray, evenly between near and far"""
    training_free_space: int = 3
    """samples a training ray, on the last stretch before its known depth"""
    free_space_reach: float = 0.5
    """length of that stretch [m]"""
    training_surface: int = 3
    """samples a training ray, around its known depth"""
    surface_deviation: float = 0.02
    """standard deviation of those [m]"""
    training_importance: int = 0
    """samples a training ray, where the even ones found density; 0 where depth says where to look"""
    rendering_stratified: int = 40
    """samples a ray without depth, evenly"""
    rendering_importance: int = 24
    """samples a ray without depth, where the first ones found density"""

    def __post_init__(self) -> None:
        if self.training_importance and self.training_stratified < 2:
            raise UserError("sampling.training_importance needs at least 2 training_stratified samples")
        if self.training_stratified < 1 or self.rendering_stratified < 2:
            raise UserError("sampling: rays need at least 1 stratified sample in training and 2 in rendering")
        counts = self.training_free_space, self.training_surface, self.training_importance, self.rendering_importance
        if min(counts) < 0:
            raise UserError("sampling: numbers of samples must not be negative")
        if self.near is not None and self.far is not None and not 0 < self.near < self.far:
            raise UserError(f"sampling needs 0 < near < far, got near {self.near} and far {self.far}")


@dataclass
class LossConfig:
    """Weights of the losses; each is logged under its name."""

    rgb: float = 1.0
    """squared error of colours in [0, 1]"""
    semantic: float = 0.1
    """cross-entropy of class labels"""
    feature: float = 0.02
    """squared error of the teachers' features"""
    depth: float = 0.1
    """distance of the ray's weight from the known surface [m]"""
    anchor: float = 1.0
    """distance of frames from the visible middle of the classes that they follow, in units of how far those move"""


@dataclass
class PretrainConfig:
    """Keys of ``nerf-rl pretrain``."""

    data: str
    """dataset folder"""
    out: str
    """output folder"""
    objective: str = FIELD
    """what teaches the encoder: field (the radiance field), autoencoder, depth, masked (an autoencoder of hidden
    views and patches), contrastive, supervised (the true state), or random (nothing: an untrained encoder)"""
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    """multi-view encoder"""
    radiance_field: FieldConfig = field(default_factory=FieldConfig)
    """radiance field"""
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    """samples along rays"""
    losses: LossConfig = field(default_factory=LossConfig)
    """weights of the losses"""
    teachers: list[str] = field(default_factory=lambda: list(TEACHERS))
    """per-pixel features that the feature head learns: depth, normals, or your own by module:Class"""
    scenes_per_step: int = 32
    """frames in a training step"""
    rays_per_scene: int = 64
    """rays drawn over all supervising cameras of a frame"""
    class_balance: float = 0.5
    """rays are drawn with weight (class frequency)^-balance: 0 is uniform, 1 gives every class the same share"""
    change_boost: float = 4.0
    """rays of fixed cameras are drawn with weight 1 + boost x (share of frames in which its class is unusual)"""
    steps: int = 4000
    """training steps"""
    max_minutes: float | None = None
    """wall-clock budget [minutes]; schedules end with it"""
    stop_when: str | None = None
    """measure of a validation that ends the run, such as miou>=0.9, psnr_db>=24, ssim>=0.8 or depth_mae_m<=0.03"""
    learning_rate: float = 7e-4
    """peak rate of Adam"""
    coarse_to_fine: float = 0.4
    """share of the run after which moving frames see all octaves of a point; before, the finer ones open one by one"""
    steps_per_epoch: int = 250
    """steps between two checkpoints"""
    epochs_per_validation: int = 4
    """checkpoints between two validations"""
    validation_frames: int = 16
    """held-out frames that are rendered whole"""
    probe_frames: int = 4000
    """training frames that probes are fitted on"""
    precision: str = "auto"
    """auto (whichever was measured to train better on such a device), 32 or bf16"""
    accelerator: str = "auto"
    """cpu, gpu, or auto (a GPU if there is one), as Lightning calls them"""
    devices: int = 1
    """devices of each node that share every step, each with a process of its own"""
    nodes: int = 1
    """machines; several need torchrun or srun to start the processes"""
    strategy: str = "auto"
    """how several devices train together: auto or ddp (distributed data parallel)"""
    loader_workers: int | None = None
    """processes that prepare batches, of each device; 0: a thread of the training process (null: 0, on a GPU 2)"""
    threads: int | None = None
    """CPU threads of a training process (null: PyTorch's own choice, divided by the devices of a node)"""
    log_every: int = 25
    """steps between two rows of the logs"""
    loggers: list[str] = field(default_factory=lambda: [TENSORBOARD])
    """where curves go besides metrics.csv: tensorboard, wandb, mlflow, or your own Lightning logger by module:Class"""
    seed: int = 0
    """seed of everything random"""
    resume: bool = False
    """continue from the last checkpoint"""
    overwrite: bool = False
    """replace an existing run"""

    def __post_init__(self) -> None:
        check_loggers(self.loggers)
        for teacher in self.teachers:
            if teacher not in TEACHERS and ":" not in teacher:
                raise UnknownNameError("teacher", teacher, TEACHERS)
        choices = {"precision": PRECISIONS, "accelerator": ACCELERATORS, "strategy": STRATEGIES}
        for name, available in (choices | {"objective": OBJECTIVES}).items():
            if getattr(self, name) not in available:
                raise UnknownNameError(name, getattr(self, name), available)
        positive = "scenes_per_step rays_per_scene steps steps_per_epoch epochs_per_validation validation_frames"
        for name in f"{positive} probe_frames devices nodes log_every".split():
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        for name, least in (("threads", 1), ("loader_workers", 0)):
            if (value := getattr(self, name)) is not None and value < least:
                raise UserError(f"--{name} must be at least {least}, got {value}")
        if self.scenes_per_step % self.processes:
            raise UserError(
                f"--scenes_per_step {self.scenes_per_step} cannot be shared evenly by {self.processes} processes "
                "(--devices times --nodes)"
            )
        if self.objective != FIELD and self.processes > 1:
            raise UserError(f"--objective {self.objective} is trained on one device; only {FIELD} is shared by several")
        require_most(self, scenes_per_step=2**16, rays_per_scene=2**16, loader_workers=1024, threads=1024, devices=1024)
        if self.scenes_per_step * self.rays_per_scene > 2**22:
            raise UserError("scenes_per_step x rays_per_scene is at most 2^22")
        require_seed(self.seed)
        if self.learning_rate <= 0:
            raise UserError(f"--learning_rate must be positive, got {self.learning_rate}")
        if not 0 < self.coarse_to_fine <= 1:
            raise UserError(f"--coarse_to_fine must be in (0, 1], got {self.coarse_to_fine}")
        if self.stop_when is not None:
            if self.objective != FIELD:
                raise UserError(f"--stop_when needs validations, which --objective {self.objective} has none of")
            parse_goal(self.stop_when)
        if self.max_minutes is not None and self.max_minutes <= 0:
            raise UserError(f"--max_minutes must be positive, got {self.max_minutes}")

    @property
    def processes(self) -> int:
        """How many processes share a step."""
        return self.devices * self.nodes

    def content(self) -> dict[str, Any]:
        """Return the keys that must not change when a run is resumed."""
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in _HOW_NOT_WHAT.split()}


@dataclass
class ProbeConfig:
    """Keys of ``nerf-rl probe``."""

    encoder: str
    """run folder, exported encoder, Lightning checkpoint or hf://USER/NAME (extra hub)"""
    data: str
    """dataset folder, rendered with the encoder's camera rig"""
    out: str | None = None
    """output folder for summary.json; only printed if null"""
    frames: int = 4000
    """training frames that the probes are fitted on"""
    ceiling_steps: int = 0
    """steps of a third encoder, of the same size, that learns the true state itself: 1000 show what is possible"""
    seed: int = 0
    """seed of the encoders that stand beside"""
    device: str = "auto"
    """where to encode: cpu, cuda, cuda:1 or auto (a GPU if there is one)"""
    overwrite: bool = False
    """replace an existing output folder"""

    def __post_init__(self) -> None:
        require_seed(self.seed)
        if self.frames < 2:
            raise UserError(f"--frames must be at least 2, got {self.frames}")
        if self.ceiling_steps < 0:
            raise UserError(f"--ceiling_steps must not be negative, got {self.ceiling_steps}")
        check_device_name(self.device)
