"""What pretraining is made of: encoder, radiance field, sampling, losses, optimisation."""

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from nerf_rl.arguments.limits import (
    Count,
    Limits,
    Natural,
    NotNegative,
    Positive,
    PositiveShare,
    Processes,
    Seed,
    check_values,
)
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.loggers import TENSORBOARD, check_loggers
from nerf_rl.machine.devices import check_device_name
from nerf_rl.pretrain.stopping import parse_goal

TEACHERS = ("depth", "normals")
_MOST_IN_A_PLANE = 2**27
FIELD: Final = "field"
ANCHORS: Final = "anchors"
SUPERVISED: Final = "supervised"
RANDOM: Final = "random"
Objective = Literal["field", "anchors", "autoencoder", "depth", "masked", "contrastive", "supervised", "random"]
_HOW_NOT_WHAT = (
    "data out resume overwrite threads loader_workers step_graph steps max_minutes accelerator devices nodes strategy"
)
_HOW_NOT_WHAT += " log_every loggers stop_when"


@dataclass
class EncoderConfig:
    """The multi-view encoder z = h(mean_i g(CNN(o_i), K_i))."""

    latent: Annotated[int, Limits(least=1, most=2**14)] = 128
    """size of z"""
    patch: Annotated[int, Limits(least=1, most=2**12)] = 4
    """the first convolution reads patches of this size, without overlap [pixels]"""
    channels: list[Annotated[int, Limits(least=1, most=2**12)]] = field(default_factory=lambda: [48, 96, 128])
    """of the convolutions; each after the first halves the image"""
    hidden: Annotated[int, Limits(least=1, most=2**14)] = 256
    """width of g and h"""
    landmarks: bool = True
    """segment what the cameras see, and tell z where the classes are that move, triangulated with camera matrices;
    without losses.anchor no class is known to move"""

    def __post_init__(self) -> None:
        check_values(self, "encoder.")
        if not self.channels:
            raise UserError("--encoder.channels must name a convolution or more")

    def cells(self, pixels: int) -> int:
        """Return how many places are left along a side of an image of so many pixels after the convolutions.

        Raises:
            UserError: the image is smaller than a patch.
        """
        if pixels < self.patch:
            raise UserError(f"--encoder.patch {self.patch} is larger than images of {pixels} pixels")
        halved = len(self.channels) - 1
        return -(-(pixels // self.patch) // 2**halved)  # each rounds up, which is the same as once in the end


@dataclass
class FieldConfig:
    """The latent-conditioned radiance field: static feature planes beside a network that sees z."""

    width: Annotated[int, Limits(least=1, most=2**13)] = 128
    """of the network and of the features that are composited along a ray"""
    layers: Annotated[int, Limits(least=1, most=64)] = 3
    """hidden layers"""
    frequencies: Annotated[int, Limits(least=0, most=64)] = 6
    """octaves of the positional encoding"""
    free_frames: Annotated[int, Limits(least=0, most=2**10)] = 4
    """frames with origins linear in z, in which points are encoded as well, beside one for each class that moves"""
    plane_size: Annotated[int, Limits(least=1, most=2**12)] = 128
    """cells along an edge of the three static feature planes"""
    object_plane_size: Annotated[int, Limits(least=0, most=2**12)] = 64
    """cells along an edge of the three feature planes that move with each class that does; 0: there are none"""
    plane_features: Annotated[int, Limits(least=1, most=2**10)] = 8
    """features in a cell"""

    def __post_init__(self) -> None:
        check_values(self, "radiance_field.")
        for size in ("plane_size", "object_plane_size"):
            if getattr(self, size) ** 2 * self.plane_features > _MOST_IN_A_PLANE:
                raise UserError(f"radiance_field: planes have at most 2^27 values, {size}^2 x plane_features, each")


@dataclass
class SamplingConfig:
    """Where rays are evaluated."""

    near: Positive | None = None
    """nearest planar depth [m]; from the data's depth if null"""
    far: Positive | None = None
    """depth beyond which everything is one backdrop [m]; from the data's depth if null"""
    scene_box: bool = True
    """rays are evaluated within the box of all that the data's depth shows before the backdrop, and not outside"""
    training_stratified: Count = 4
    """samples a training ray, evenly between near and far"""
    training_free_space: Natural = 3
    """samples a training ray, on the last stretch before its known depth"""
    free_space_reach: NotNegative = 0.5
    """length of that stretch, in distances of things from the encoder's cameras"""
    training_surface: Natural = 3
    """samples a training ray, around its known depth"""
    surface_deviation: NotNegative = 0.02
    """standard deviation of those, in distances of things from the encoder's cameras"""
    training_importance: Natural = 0
    """samples a training ray, where the even ones found density; 0 where depth says where to look"""
    rendering_stratified: Annotated[int, Limits(least=2)] = 40
    """samples a ray without depth, evenly"""
    rendering_importance: Natural = 24
    """samples a ray without depth, where the first ones found density"""

    def __post_init__(self) -> None:
        check_values(self, "sampling.")
        if self.training_importance and self.training_stratified < 2:
            raise UserError("sampling.training_importance needs at least 2 training_stratified samples")
        if self.near is not None and self.far is not None and not 0 < self.near < self.far:
            raise UserError(f"sampling needs 0 < near < far, got near {self.near} and far {self.far}")


@dataclass
class LossConfig:
    """Weights of the losses; each is logged under its name."""

    rgb: NotNegative = 1.0
    """squared error of colours in [0, 1]"""
    semantic: NotNegative = 0.1
    """cross-entropy of class labels"""
    feature: NotNegative = 0.02
    """squared error of the teachers' features"""
    depth: NotNegative = 0.1
    """distance of the ray's weight from the known surface, in distances of things from the encoder's cameras"""
    anchor: NotNegative = 1.0
    """distance of frames from the visible middle of the classes that they follow, in units of how far those move"""
    segmentation: NotNegative = 0.3
    """cross-entropy of what the cells of the encoder's pictures show, by which it finds landmarks"""

    def __post_init__(self) -> None:
        check_values(self, "losses.")


@dataclass
class PretrainConfig:
    """Keys of ``nerf-rl pretrain``."""

    data: str
    """dataset folder"""
    out: str
    """output folder"""
    objective: Objective = FIELD
    """what teaches the encoder: field (the radiance field), anchors (where the cameras see each class that moves),
    autoencoder, depth, masked (an autoencoder of hidden views and patches), contrastive, supervised (the true state),
    or random (nothing: an untrained encoder)"""
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
    scenes_per_step: Annotated[int, Limits(least=1, most=2**16)] = 32
    """frames in a training step"""
    rays_per_scene: Annotated[int, Limits(least=1, most=2**16)] = 64
    """rays drawn over all supervising cameras of a frame"""
    class_balance: Annotated[float, Limits(least=0, most=100)] = 0.25
    """rays are drawn with weight (class frequency)^-balance: 0 is uniform, 1 gives every class the same share"""
    change_boost: NotNegative = 4.0
    """rays of fixed cameras are drawn with weight 1 + boost x (share of frames in which its class is unusual)"""
    steps: Count = 4000
    """training steps"""
    max_minutes: Positive | None = None
    """wall-clock budget of training, validations apart [minutes]; schedules end with it"""
    stop_when: str | None = None
    """a validation's "miou>=0.9", "psnr_db>=24", "ssim>=0.8" or "depth_mae_m<=0.03", in quotes, that ends the run"""
    learning_rate: Positive = 1e-3
    """peak rate of Adam"""
    field_rate: Positive = 2.0
    """learning rate of the radiance field's layers, in learning rates of all else"""
    coarse_to_fine: PositiveShare = 0.4
    """share of the run after which moving frames see all octaves of a point; before, the finer ones open one by one"""
    steps_per_epoch: Count = 250
    """steps between two checkpoints"""
    epochs_per_validation: Count = 4
    """checkpoints between two validations"""
    validation_frames: Count = 16
    """held-out frames that are rendered whole"""
    probe_frames: Count = 4000
    """training frames that probes are fitted on"""
    precision: Literal["auto", "32", "bf16"] = "auto"
    """auto (whichever was measured to train better on such a device), 32 or bf16"""
    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    """cpu, gpu, or auto (a GPU if there is one), as Lightning calls them"""
    devices: Processes = 1
    """devices of each node that share every step, each with a process of its own"""
    nodes: Count = 1
    """machines; several need torchrun or srun to start the processes"""
    strategy: Literal["auto", "ddp"] = "auto"
    """how several devices train together: auto or ddp (distributed data parallel)"""
    loader_workers: Annotated[int, Limits(least=0, most=1024)] | None = None
    """processes that prepare batches, of each device; 0: a thread of the training process (null: 0, on a GPU 4)"""
    step_graph: bool = True
    """on one GPU in float32, capture a step of the radiance field as a CUDA graph and replay that; otherwise nothing"""
    threads: Processes | None = None
    """CPU threads of a training process (null: PyTorch's own choice, divided by the devices of a node)"""
    log_every: Count = 25
    """steps between two rows of the logs"""
    loggers: list[str] = field(default_factory=lambda: [TENSORBOARD])
    """where curves go besides metrics.csv: tensorboard, wandb, mlflow, or your own Lightning logger by module:Class"""
    seed: Seed = 0
    """seed of everything random"""
    resume: bool = False
    """continue from the last checkpoint"""
    overwrite: bool = False
    """replace an existing run"""

    def __post_init__(self) -> None:
        check_values(self)
        check_loggers(self.loggers)
        for teacher in self.teachers:
            if teacher not in TEACHERS and ":" not in teacher:
                raise UnknownNameError("teacher", teacher, TEACHERS)
        if self.scenes_per_step % self.processes:
            raise UserError(
                f"--scenes_per_step {self.scenes_per_step} cannot be shared evenly by {self.processes} processes "
                "(--devices times --nodes)"
            )
        if self.objective != FIELD and self.processes > 1:
            raise UserError(f"--objective {self.objective} is trained on one device; only {FIELD} is shared by several")
        if self.scenes_per_step * self.rays_per_scene > 2**22:
            raise UserError("scenes_per_step x rays_per_scene is at most 2^22")
        if self.stop_when is not None:
            if self.objective != FIELD:
                raise UserError(f"--stop_when needs validations, which --objective {self.objective} has none of")
            parse_goal(self.stop_when)

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
    frames: Annotated[int, Limits(least=2)] = 4000
    """training frames that the probes are fitted on"""
    ceiling_steps: Natural = 0
    """steps of a third encoder, of the same size, that learns the true state itself: 1000 show what is possible"""
    seed: Seed = 0
    """seed of the encoders that stand beside"""
    device: str = "auto"
    """where to encode: cpu, cuda, cuda:1 or auto (a GPU if there is one)"""
    overwrite: bool = False
    """replace an existing output folder"""

    def __post_init__(self) -> None:
        check_values(self)
        check_device_name(self.device)
