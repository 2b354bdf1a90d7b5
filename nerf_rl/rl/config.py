"""What a training run is made of; importing this module loads nothing heavy."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from nerf_rl.arguments.limits import require_most, require_seed
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.loggers import TENSORBOARD, check_loggers
from nerf_rl.machine.backends import check_backend
from nerf_rl.machine.devices import check_device_name
from nerf_rl.rl.baselines.config import PPOConfig
from nerf_rl.rl.sweeps.seed_list import parse_seeds

NO_ENCODER = "none"
BASELINES = ("ppo", "sb3-ddpg")
ALGORITHMS = ("ddpg", *BASELINES)

NO_CONTROL, BLIND, RANDOM = "none", "blind", "random"
CONTROLS = (NO_CONTROL, BLIND, RANDOM)
HOLD_KINDS = ("corner", "anywhere")


@dataclass
class NetworkConfig:
    """Actor and critic."""

    hidden: list[int] = field(default_factory=lambda: [256, 400])
    """widths of the two hidden layers; the action joins the critic after the first"""
    normalisation: str = "layer"
    """layer, batch or none, after each hidden linear layer"""
    standardise: bool = True
    """standardise observations by the running mean and deviation of those seen in training"""

    def __post_init__(self) -> None:
        require_most(self, "network.", hidden=2**14)
        if len(self.hidden) != 2 or min(self.hidden) < 1:
            raise UserError(f"--network.hidden needs two positive widths, got {self.hidden}")
        _one_of("normalisation", self.normalisation, ("layer", "batch", "none"))


@dataclass
class NoiseConfig:
    """Exploration noise on actions in [-1, 1]; its standard deviation falls linearly."""

    kind: str = "pink"
    """gaussian (independent in time), ou (Ornstein-Uhlenbeck) or pink (correlated at all time scales)"""
    start: float = 1.0
    """standard deviation at the first step"""
    end: float = 0.1
    """standard deviation after decay_steps"""
    decay_steps: int = 30_000
    """environment steps from start to end"""
    theta: float = 0.15
    """ou only: share of the noise that is forgotten in each step"""
    hold_share: float = 0.1
    """share of the first agent steps that repeat a random action instead; it falls with the noise, 0 switches it off"""
    hold_start: float = 1.0
    """probability that one of the first episodes begins with such an action; it falls with the noise"""
    hold_steps: int = 8
    """mean number of agent steps for which such an action is repeated"""
    hold_kind: str = "corner"
    """what is repeated: corner (of the action box, which moves furthest) or anywhere (in it, and every third a rest)"""

    def __post_init__(self) -> None:
        require_most(self, "noise.", start=10**6, end=10**6, hold_steps=10**9)
        _one_of("noise kind", self.kind, ("gaussian", "ou", "pink"))
        _one_of("hold kind", self.hold_kind, HOLD_KINDS)
        if self.start < 0 or self.end < 0:
            raise UserError("--noise.start and --noise.end must not be negative")
        if self.decay_steps < 1:
            raise UserError(f"--noise.decay_steps must be at least 1, got {self.decay_steps}")
        if not 0 < self.theta <= 1:
            raise UserError(f"--noise.theta must be in (0, 1], got {self.theta}")
        if not 0 <= self.hold_share < 1 or not 0 <= self.hold_start <= 1 or self.hold_steps < 1:
            raise UserError("noise needs hold_share in [0, 1), hold_start in [0, 1] and hold_steps of at least 1")


@dataclass
class ReplayConfig:
    """Replay memory on disk."""

    capacity: int = 200_000
    """transitions kept; the oldest are replaced"""
    prioritised: bool = True
    """draw transitions in proportion to (|temporal-difference error| + epsilon)^alpha instead of uniformly"""
    alpha: float = 0.6
    """exponent of the priorities; 0 is uniform"""
    beta: float = 0.4
    """exponent of the importance weights at the start; it grows linearly to 1 at the last step"""
    epsilon: float = 0.01
    """added to each absolute error, so that no transition is forgotten"""
    good_share: float = 0.0
    """share of each batch that is drawn from the best episodes"""
    good_episodes: float = 0.1
    """share of all episodes, by return, that are the best ones"""
    demonstration_share: float = 0.5
    """share of each batch that is drawn from the demonstrations, which are never replaced; only if there are any"""
    hindsight: int = 0
    """copies of each transition with goals that were reached; only for scenes with a goal"""
    hindsight_random: float = 0.0
    """share of these goals that were reached at any time in training; the others were, later in the same episode"""

    def __post_init__(self) -> None:
        require_most(self, "replay.", capacity=10**10, alpha=100, epsilon=10**6, hindsight=1000)
        if self.capacity < 1:
            raise UserError(f"--replay.capacity must be at least 1, got {self.capacity}")
        if not 0 <= self.good_share < 1 or not 0 < self.good_episodes <= 1:
            raise UserError("replay needs good_share in [0, 1) and good_episodes in (0, 1]")
        if not 0 <= self.demonstration_share < 1:
            raise UserError(f"--replay.demonstration_share must be in [0, 1), got {self.demonstration_share}")
        if not 0 <= self.hindsight_random <= 1:
            raise UserError(f"--replay.hindsight_random must be in [0, 1], got {self.hindsight_random}")
        if self.hindsight < 0:
            raise UserError(f"--replay.hindsight must not be negative, got {self.hindsight}")
        if self.alpha < 0 or not 0 <= self.beta <= 1 or self.epsilon <= 0:
            raise UserError("replay needs alpha >= 0, beta in [0, 1] and epsilon > 0")


@dataclass
class LearnerConfig:
    """Deep deterministic policy gradient."""

    gamma: float = 0.97
    """discount of one agent step"""
    n_step: int = 3
    """agent steps whose rewards are summed before bootstrapping"""
    tau: float = 0.01
    """share of the network that enters its target in each update"""
    actor_rate: float = 3e-4
    """learning rate of the actor"""
    critic_rate: float = 1e-3
    """learning rate of the critic"""
    batch_size: int = 128
    """transitions in an update"""
    max_grad_norm: float = 10.0
    """gradients longer than this are shortened"""
    pre_tanh_penalty: float = 0.02
    """weight of the mean squared pre-tanh activation in the actor's loss: keeps actions off the flat ends of tanh"""
    actor_every: int = 1
    """critic updates for each update of the actor"""
    actor_batch: str = "uniform"
    """uniform: the actor learns from a batch of its own; prioritised: from the critic's batch"""
    reward_scale: float = 0.1
    """factor on rewards inside the learner; reported returns are unscaled"""
    updates_per_step: float = 1.0
    """gradient updates per agent step"""
    reset_after: int = 0
    """environment steps without a success, or without a better return where success is not told, after which networks
    and exploration start anew; 0 for never"""
    reset_updates: int = 1000
    """updates that fresh networks are given at once, from the memory so far"""
    clone_steps: int = 1000
    """with demonstrations: steps in which the actor is drawn to the demonstrated actions, and the critic learns what
    they are worth, before anything else is learnt"""
    clone_weight: float = 1.0
    """with demonstrations: weight, at first, of the mean squared distance from the demonstrated actions in the actor's
    loss, in units of the mean absolute action value; 0 for none"""
    clone_updates: int = 20_000
    """critic updates within which that weight falls to 0"""

    def __post_init__(self) -> None:
        require_most(self, "learner.", batch_size=2**20, n_step=10**6, updates_per_step=1000)
        require_most(self, "learner.", actor_every=10**9, reset_updates=10**7, clone_steps=10**7)
        require_most(self, "learner.", clone_weight=10**6, clone_updates=10**12)
        _one_of("actor batch", self.actor_batch, ("uniform", "prioritised"))
        if not 0 <= self.gamma <= 1:
            raise UserError(f"--learner.gamma must be in [0, 1], got {self.gamma}")
        if not 0 < self.tau <= 1:
            raise UserError(f"--learner.tau must be in (0, 1], got {self.tau}")
        for name in ("n_step", "batch_size", "actor_every", "clone_updates"):
            if getattr(self, name) < 1:
                raise UserError(f"--learner.{name} must be at least 1, got {getattr(self, name)}")
        for name in ("actor_rate", "critic_rate", "max_grad_norm", "reward_scale", "updates_per_step"):
            if getattr(self, name) <= 0:
                raise UserError(f"--learner.{name} must be positive, got {getattr(self, name)}")
        for name in ("reset_after", "reset_updates", "clone_steps", "clone_weight"):
            if getattr(self, name) < 0:
                raise UserError(f"--learner.{name} must not be negative, got {getattr(self, name)}")
        if self.pre_tanh_penalty < 0:
            raise UserError(f"--learner.pre_tanh_penalty must not be negative, got {self.pre_tanh_penalty}")


@dataclass
class PandaReachConfig:
    """The scene panda/reach; the keys do nothing in other scenes."""

    control: str = "joints"
    """joints (7 actions, changes of joint angles) or ee (3 actions, displacements of the end-effector)"""
    reward: str = "dense"
    """dense (minus the distance), bonus (dense, and 1 on arrival) or sparse (1 on arrival)"""
    observation: str = "full"
    """paper (joint angles, position, goal), panda-gym (velocity, position, goal) or full (all of them and
    the displacement from position to goal)"""

    def __post_init__(self) -> None:
        _one_of("control", self.control, ("joints", "ee"))
        _one_of("reward", self.reward, ("dense", "bonus", "sparse"))
        _one_of("observation", self.observation, ("full", "paper", "panda-gym"))


@dataclass
class TrainRLConfig:
    """Keys of ``nerf-rl train-rl``."""

    out: str
    """run folder"""
    encoder: str = NO_ENCODER
    """run folder of pretrain, exported encoder, Lightning .ckpt, or hf://USER/NAME[@REVISION] (extra hub); none
    observes the true state"""
    scene: str = "metaworld/drawer-open-v3"
    """metaworld/TASK, gym/ID, gym/MODULE:ID or panda/reach (extra panda); with an encoder, the encoder's scene"""
    control: str = NO_CONTROL
    """blind (latents are zero) or random (an encoder that nobody trained) in place of the encoder, with everything else
    the same: what stands beside a success rate"""
    observe: list[str] = field(default_factory=list)
    """columns of the true state that an agent with an encoder sees as well, such as a goal that no camera shows: names
    (goal_x) or groups (goal) of the scene's privileged columns, desired_goal or achieved_goal of a goal environment"""
    panda: PandaReachConfig = field(default_factory=PandaReachConfig)
    """panda/reach only"""
    demonstrations: int = 0
    """successful episodes of the scene's scripted policy to begin with, for scenes that have one: a share of each batch
    is drawn from them, and the actor is cloned from them; their environment steps, failed tries among them, are part of
    env_steps"""
    demonstration_noise: float = 0.2
    """standard deviation of the noise on their actions: beside what a script without any noise does, a critic knows
    nothing"""
    env_steps: int = 50_000
    """environment steps of training, over all environments and with action repeats and demonstrations counted"""
    episodes: int = 0
    """training episodes after which training ends, if env_steps have not ended it before; 0 for no such limit"""
    action_repeat: int = 2
    """environment steps for which an action is held"""
    episode_steps: int = 200
    """environment steps after which an episode is truncated, unless a Gymnasium environment ends it sooner"""
    envs: int = 2
    """environments, each in a process of its own"""
    warmup_steps: int = 2_000
    """environment steps of random actions at the beginning, after demonstrations"""
    learning_starts: int | None = None
    """environment steps before the first update; by default as many as warmup_steps"""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """actor and critic"""
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    """the algorithm"""
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    """exploration"""
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    """memory"""
    evaluation_every: int = 5_000
    """environment steps between evaluations"""
    evaluation_episodes: int = 10
    """episodes of each evaluation but the last"""
    final_evaluation_episodes: int = 20
    """episodes of the last evaluation"""
    evaluation_to_end: bool = False
    """go on after an evaluated episode's success, so that mean_return is that of whole episodes"""
    checkpoint_every: int = 10_000
    """environment steps between checkpoints"""
    log_every: int = 1_000
    """environment steps between rows of metrics.csv"""
    loggers: list[str] = field(default_factory=lambda: [TENSORBOARD])
    """where curves go besides metrics.csv: tensorboard, wandb, mlflow, or your own Lightning logger by module:Class"""
    algo: str = "ddpg"
    """ddpg (ours), an algorithm of your own that learns from replay by module:Class, or by Stable-Baselines3 (extra
    sb3): ppo, with the keys of ppo, or sb3-ddpg, with those of learner, noise and replay that it shares"""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """ppo only"""
    seed: int = 0
    """seed of everything random"""
    seeds: str = ""
    """a run for each of several seeds instead, such as 0..19 or 0,3,5: in seed-N of out, with a summary of all"""
    workers: int | None = None
    """with seeds: how many are trained at a time; by default as many as there are cores, or threads of them each"""
    backend: str = "loky"
    """with seeds: where: loky: on this machine; ray: on a Ray cluster (extra 'ray'; RAY_ADDRESS names it)"""
    threads: int = 1
    """threads of the learner; the environments have one each"""
    device: str = "cpu"
    """where to learn, and where each environment's process runs its encoder: cpu, cuda, cuda:1 or auto. Networks and
    batches are so small that a CPU is about as fast, and each process takes memory of a GPU for itself"""
    resume: bool = False
    """go on from the last checkpoint of an interrupted run"""
    overwrite: bool = False
    """replace an existing run"""

    def __post_init__(self) -> None:
        if ":" not in self.algo:
            _one_of("algorithm", self.algo, ALGORITHMS)
        _one_of("control", self.control, CONTROLS)
        if self.control != NO_CONTROL and self.encoder == NO_ENCODER:
            raise UserError(f"--control {self.control} is for agents with an encoder; give the one to compare with")
        if self.observe and self.encoder == NO_ENCODER:
            raise UserError(
                "--observe adds to what an encoder sees; without --encoder the whole true state is observed"
            )
        check_loggers(self.loggers)
        counts = "env_steps action_repeat episode_steps envs evaluation_every evaluation_episodes"
        for name in f"{counts} final_evaluation_episodes checkpoint_every log_every threads".split():
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        for name in ("episodes", "warmup_steps", "learning_starts"):
            if (getattr(self, name) or 0) < 0:
                raise UserError(f"--{name} must not be negative, got {getattr(self, name)}")
        check_device_name(self.device)
        require_most(self, envs=1024, threads=1024, env_steps=10**12, episode_steps=10**9)
        require_seed(self.seed)
        self._check_seeds()
        self._check_demonstrations()
        if self.warmup_steps >= self.env_steps:
            raise UserError(
                f"--warmup_steps {self.warmup_steps} leaves nothing of --env_steps {self.env_steps} to learn in"
            )
        if self.algo == "sb3-ddpg" and self.learning_starts not in (None, self.warmup_steps):
            raise UserError("--algo sb3-ddpg learns from the end of --warmup_steps on; leave out --learning_starts")
        if self.algo == "sb3-ddpg" and self.noise.kind == "pink":
            raise UserError("--algo sb3-ddpg has no pink noise; use --noise.kind gaussian or ou")
        if self.episode_steps < self.action_repeat:
            raise UserError(f"--episode_steps {self.episode_steps} is less than --action_repeat {self.action_repeat}")

    def content(self) -> dict[str, Any]:
        """Return the keys that must not change when a run is resumed."""
        free = "out resume overwrite seeds workers backend env_steps episodes threads device checkpoint_every"
        free += " evaluation_every evaluation_episodes final_evaluation_episodes evaluation_to_end log_every loggers"
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in free.split()}

    def _check_demonstrations(self) -> None:
        require_most(self, demonstrations=10**4, demonstration_noise=10**6)
        if self.demonstrations < 0 or self.demonstration_noise < 0:
            raise UserError("--demonstrations and --demonstration_noise must not be negative")
        if not self.demonstrations:
            return
        if self.algo in BASELINES:
            raise UserError(f"--demonstrations is for --algo ddpg; {self.algo} of Stable-Baselines3 takes none")
        if self.replay.good_share + self.replay.demonstration_share >= 1:
            raise UserError(
                f"--replay.good_share {self.replay.good_share} and --replay.demonstration_share "
                f"{self.replay.demonstration_share} leave nothing of a batch to all other episodes"
            )
        spent = self.demonstrations * self.episode_steps
        if spent + self.warmup_steps >= self.env_steps:
            raise UserError(
                f"--demonstrations {self.demonstrations} of {self.episode_steps} steps each and --warmup_steps "
                f"{self.warmup_steps} leave nothing of --env_steps {self.env_steps} to learn in"
            )

    def _check_seeds(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UserError(f"--workers must be at least 1, got {self.workers}")
        require_most(self, workers=1024)
        check_backend(self.backend, self.workers)
        if self.seeds and parse_seeds(self.seeds) and self.seed:
            raise UserError(f"--seeds {self.seeds} leaves no room for --seed {self.seed}; give one of them")


def _one_of(kind: str, name: str, available: tuple[str, ...]) -> None:
    if name not in available:
        raise UnknownNameError(kind, name, available)
