"""What a training run is made of; importing this module loads nothing heavy."""

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
    Share,
    ShareBelowOne,
    check_values,
)
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.loggers import TENSORBOARD, check_loggers
from nerf_rl.machine.backends import check_backend
from nerf_rl.machine.devices import check_device_name
from nerf_rl.rl.baselines.config import PPOConfig
from nerf_rl.rl.sweeps.seed_list import parse_seeds

NO_ENCODER = "none"
OFF_POLICY_BASELINES = ("sb3-ddpg", "sb3-td3", "sb3-sac")
BASELINES = ("ppo", *OFF_POLICY_BASELINES)
ALGORITHMS = ("ddpg", *BASELINES)

NO_CONTROL: Final = "none"
BLIND: Final = "blind"
RANDOM: Final = "random"
Control = Literal["none", "blind", "random"]
EYES_OF_CONTROLS = {
    BLIND: "the same agent, trained with latents of zero",
    RANDOM: "the same agent, trained with an encoder that nobody trained",
}
"""what has to stand beside the figures and the pictures of a control"""

LATEST_EPISODES = 20
"""of training, among which exploration waits for successes"""


@dataclass
class NetworkConfig:
    """Actor and critic."""

    hidden: list[Annotated[int, Limits(least=1, most=2**14)]] = field(default_factory=lambda: [256, 400])
    """widths of the two hidden layers; the action joins the critic after the first"""
    normalisation: Literal["layer", "batch", "none"] = "layer"
    """layer, batch or none, after each hidden linear layer"""
    standardise: bool = True
    """standardise observations by the running mean and deviation of those seen in training"""

    def __post_init__(self) -> None:
        check_values(self, "network.")
        if len(self.hidden) != 2:
            raise UserError(f"--network.hidden needs two widths, got {self.hidden}")


@dataclass
class NoiseConfig:
    """Exploration noise on actions in [-1, 1], and random ones that are held; both become less, linearly."""

    kind: Literal["gaussian", "ou", "pink"] = "pink"
    """gaussian (independent in time), ou (Ornstein-Uhlenbeck) or pink (correlated at all time scales)"""
    start: Annotated[float, Limits(least=0, most=10**6)] = 1.0
    """standard deviation at the first step"""
    end: Annotated[float, Limits(least=0, most=10**6)] = 0.1
    """standard deviation after decay_steps"""
    decay_steps: Count = 30_000
    """environment steps from start to end"""
    wait_for_successes: Annotated[int, Limits(least=0, most=LATEST_EPISODES)] = 0
    """let exploration become less only once so many of the last 20 training episodes have succeeded, where the scene
    tells of success; 0 waits for none"""
    renew_after: Natural = 0
    """training episodes in a row, but for echoes (echo_share), without a success after which exploration is as at first
    again, and becomes less anew; 0: never"""
    retries: Literal["first", "drawn"] = "first"
    """standard deviation where a start that failed is tried again (retry_share): first (the first step's) or drawn
    (anew for each retry, between 0 and that), and never less than that of other episodes"""
    theta: PositiveShare = 0.15
    """ou only: share of the noise that is forgotten in each step"""
    epsilon_z: ShareBelowOne = 0.1
    """share of the first agent steps that repeat a random action instead; it falls with the noise, 0 switches it off"""
    epsilon_z_start: Share = 1.0
    """probability that one of the first episodes begins with such an action; it falls with the noise"""
    epsilon_z_steps: Annotated[int, Limits(least=1, most=10**9)] = 8
    """mean number of agent steps for which such an action is repeated"""
    epsilon_z_kind: Literal["corner", "anywhere"] = "corner"
    """what is repeated: corner (of the action box, which moves furthest) or anywhere (in it, and every third a rest)"""
    epsilon_z_retries: ShareBelowOne = 0.0
    """least share of the agent steps that do so where a start that failed is tried again (retry_share), however late"""

    def __post_init__(self) -> None:
        check_values(self, "noise.")


@dataclass
class ReplayConfig:
    """Replay memory on disk."""

    capacity: Annotated[int, Limits(least=1, most=10**10)] = 200_000
    """transitions kept; the oldest are replaced"""
    prioritised: bool = True
    """draw transitions in proportion to (|temporal-difference error| + epsilon)^alpha instead of uniformly"""
    alpha: Annotated[float, Limits(least=0, most=10)] = 0.6
    """exponent of the priorities; 0 is uniform"""
    beta: Share = 0.4
    """exponent of the importance weights at the start; it grows linearly to 1 at the last step"""
    epsilon: Annotated[float, Limits(above=0, most=10**6)] = 0.01
    """added to each absolute error, so that no transition is forgotten"""
    demonstration_share: ShareBelowOne = 0.5
    """share of each batch that is drawn from the demonstrations, which are never replaced; only if there are any"""
    hindsight: Annotated[int, Limits(least=0, most=1000)] = 0
    """copies of each transition with goals that were reached; only for scenes with a goal, and an action_repeat of 1"""
    hindsight_random: Share = 0.0
    """share of these goals that were reached at any time in training; the others were, later in the same episode"""

    def __post_init__(self) -> None:
        check_values(self, "replay.")
        if self.prioritised and self.epsilon**self.alpha < 1e-30:  # 32 bits have no number below 1e-38 but zero
            raise UserError(f"--replay.epsilon {self.epsilon} to the power of --replay.alpha {self.alpha} is too small")


@dataclass
class LearnerConfig:
    """Deep deterministic policy gradient."""

    gamma: Share = 0.97
    """discount of one agent step"""
    n_step: Annotated[int, Limits(least=1, most=10**6)] = 3
    """agent steps whose rewards are summed before bootstrapping"""
    tau: PositiveShare = 0.01
    """share of the network that enters its target in each update"""
    actor_rate: Positive = 3e-4
    """learning rate of the actor"""
    critic_rate: Positive = 1e-3
    """learning rate of the critic"""
    batch_size: Annotated[int, Limits(least=1, most=2**20)] = 128
    """transitions in an update"""
    max_grad_norm: Positive = 10.0
    """gradients longer than this are shortened"""
    pre_tanh_penalty: NotNegative = 0.02
    """weight of the mean squared pre-tanh activation in the actor's loss: keeps actions off the flat ends of tanh"""
    actor_every: Annotated[int, Limits(least=1, most=10**9)] = 1
    """critic updates for each update of the actor"""
    actor_batch: Literal["uniform", "prioritised"] = "uniform"
    """uniform: the actor learns from a batch of its own; prioritised: from the critic's batch"""
    policy_average: Natural = 0
    """actor updates over which the weights of the policy that is evaluated and kept are averaged, exponentially (Polyak
    and Juditsky 1992); 0 for the last weights alone"""
    reward_scale: Positive = 0.1
    """factor on rewards inside the learner; reported returns are unscaled"""
    bound_by_returns: bool = False
    """let no step's target be less than what its episode brought from it on (He et al. 2017); for environments in which
    the same actions bring the same again"""
    steady_ends: bool = False
    """with bound_by_returns or imitation_weight: expect no more behind the end of an episode that was broken off than
    its last n_step rewards over and over, since what the critic hopes for there would hold itself up"""
    imitation_weight: Annotated[float, Limits(least=0, most=10**6)] = 0.0
    """draw the actor to its own past actions where their episodes brought more than the critic expects of it now (Oh et
    al. 2018, "self-imitation learning"), by so much, times this weight; 0 for never"""
    updates_per_step: Annotated[float, Limits(above=0, most=1000)] = 1.0
    """gradient updates per agent step"""
    reset_after: Natural = 0
    """environment steps without a success, or without a better return where success is not told, after which networks
    and exploration start anew; 0 for never"""
    reset_updates: Annotated[int, Limits(least=0, most=10**7)] = 1000
    """updates that fresh networks are given at once, from the memory so far"""
    clone_steps: Annotated[int, Limits(least=0, most=10**7)] = 1000
    """with demonstrations: steps in which the actor is drawn to the demonstrated actions, and the critic learns what
    they are worth, before anything else is learnt"""
    clone_weight: Annotated[float, Limits(least=0, most=10**6)] = 1.0
    """with demonstrations: weight, at first, of the mean squared distance from the demonstrated actions in the actor's
    loss, in units of the mean absolute action value; 0 for none"""
    clone_updates: Annotated[int, Limits(least=1, most=10**12)] = 20_000
    """critic updates within which that weight falls to 0"""

    def __post_init__(self) -> None:
        check_values(self, "learner.")
        if self.steady_ends and not self.uses_returns:
            raise UserError(
                "--learner.steady_ends is of what episodes brought; give --learner.bound_by_returns or "
                "--learner.imitation_weight, too"
            )

    @property
    def uses_returns(self) -> bool:
        """Whether something is learnt from what whole episodes brought."""
        return self.bound_by_returns or self.imitation_weight > 0


@dataclass
class PandaReachConfig:
    """The scene panda/reach; the keys do nothing in other scenes."""

    control: Literal["joints", "ee"] = "joints"
    """joints (7 actions, changes of joint angles) or ee (3 actions, displacements of the end-effector)"""
    reward: Literal["dense", "bonus", "sparse"] = "dense"
    """dense (minus the distance), bonus (dense, and 1 on arrival) or sparse (1 on arrival)"""
    observation: Literal["full", "paper", "panda-gym"] = "full"
    """paper (joint angles, position, goal), panda-gym (velocity, position, goal) or full (all of them and
    the displacement from position to goal)"""

    def __post_init__(self) -> None:
        check_values(self, "panda.")


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
    control: Control = NO_CONTROL
    """blind (latents are zero) or random (an encoder that nobody trained) in place of the encoder, with everything else
    the same: what stands beside a success rate"""
    observe: list[str] = field(default_factory=list)
    """columns of the true state that an agent with an encoder sees as well, such as a goal that no camera shows: names
    (goal_x) or groups (goal) of the scene's privileged columns, desired_goal or achieved_goal of a goal environment"""
    panda: PandaReachConfig = field(default_factory=PandaReachConfig)
    """panda/reach only"""
    demonstrations: Annotated[int, Limits(least=0, most=10**4)] = 0
    """successful episodes of the scene's scripted policy to begin with, for scenes that have one: a share of each batch
    is drawn from them, and the actor is cloned from them; their environment steps, failed tries among them, are part of
    env_steps"""
    demonstration_noise: Annotated[float, Limits(least=0, most=10**6)] = 0.2
    """standard deviation of the noise on their actions: beside what a script without any noise does, a critic knows
    nothing"""
    env_steps: Annotated[int, Limits(least=1, most=10**12)] = 50_000
    """environment steps of training, over all environments and with action repeats and demonstrations counted"""
    episodes: Natural = 0
    """training episodes after which training ends, if env_steps have not ended it before; 0 for no such limit"""
    action_repeat: Count = 2
    """environment steps for which an action is held"""
    episode_steps: Annotated[int, Limits(least=1, most=10**9)] = 200
    """environment steps after which an episode is truncated, unless a Gymnasium environment ends it sooner"""
    steps_after_success: Count | None = None
    """environment steps for which a training episode goes on after its first success, once half of the last 20 at new
    places have succeeded; then it is truncated: to rest at the goal teaches less than another episode does. To its end
    by default, and where the scene does not tell of success; ddpg only"""
    success_overtime: Natural = 0
    """environment steps for which a training episode goes on after its first success even where that is beyond
    episode_steps, unless steps_after_success ends it sooner: an agent that is told to stop when it has just succeeded
    does not learn what that is worth; ddpg only"""
    success_bonus: NotNegative = 0.0
    """added to the reward of each agent step with a success, for the learner alone, where the scene's own reward makes
    little of it, as of an open drawer beside a handle that is pressed on; no return that is told has it in it; ddpg
    only"""
    retry_share: ShareBelowOne = 0.0
    """probability that a training episode begins where one has failed lately, which is tried again once, with noise
    of its own (noise.retries); from the first success on, if the scene tells of it, and ddpg only"""
    echo_share: ShareBelowOne = 0.0
    """probability that such a retry has no more noise than others, and does again, without looking, what succeeded from
    a start that is like its own; as long as successes are rare"""
    envs: Processes = 2
    """environments, each in a process of its own"""
    warmup_steps: Natural = 2_000
    """environment steps of random actions at the beginning, after demonstrations"""
    learning_starts: Natural | None = None
    """environment steps before the first update; by default as many as warmup_steps"""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """actor and critic"""
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    """the algorithm"""
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    """exploration"""
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    """memory"""
    evaluation_every: Count = 5_000
    """environment steps between evaluations"""
    evaluation_episodes: Count = 10
    """episodes of each evaluation but the last"""
    final_evaluation_episodes: Count = 20
    """episodes of the last evaluation"""
    evaluation_to_end: bool = False
    """go on after an evaluated episode's success, so that mean_return is that of whole episodes"""
    checkpoint_every: Count = 10_000
    """environment steps between checkpoints"""
    log_every: Count = 1_000
    """environment steps between rows of metrics.csv"""
    loggers: list[str] = field(default_factory=lambda: [TENSORBOARD])
    """where curves go besides metrics.csv: tensorboard, wandb, mlflow, or your own Lightning logger by module:Class"""
    algo: str = "ddpg"
    """ddpg (ours), an algorithm of your own that learns from replay by module:Class, or by Stable-Baselines3 (extra
    sb3): ppo, with the keys of ppo, or sb3-ddpg, sb3-td3 and sb3-sac, with those of learner, noise and replay that
    they share with ours"""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """ppo only"""
    seed: Seed = 0
    """seed of everything random"""
    seeds: str = ""
    """a run for each of several seeds instead, such as 0..19 or 0,3,5: in seed-N of out, with a summary of all"""
    workers: Processes | None = None
    """with seeds: how many are trained at a time; by default as many as there are cores, or threads of them each"""
    backend: str = "local"
    """with seeds: where: local: on this machine; ray: on a Ray cluster (extra 'ray'; RAY_ADDRESS names it)"""
    threads: Processes = 1
    """threads of the learner; the environments have one each"""
    device: str = "cpu"
    """where to learn, and where each environment's process runs its encoder: cpu, cuda, cuda:1 or auto. Networks and
    batches are so small that a CPU is about as fast, and each process takes memory of a GPU for itself"""
    resume: bool = False
    """go on from the last checkpoint of an interrupted run"""
    overwrite: bool = False
    """replace an existing run"""

    def __post_init__(self) -> None:
        check_values(self)
        if ":" not in self.algo and self.algo not in ALGORITHMS:
            raise UnknownNameError("algorithm", self.algo, ALGORITHMS)
        if self.control != NO_CONTROL and self.encoder == NO_ENCODER:
            raise UserError(f"--control {self.control} is for agents with an encoder; give the one to compare with")
        if self.observe and self.encoder == NO_ENCODER:
            raise UserError(
                "--observe adds to what an encoder sees; without --encoder the whole true state is observed"
            )
        check_loggers(self.loggers)
        check_device_name(self.device)
        self._check_seeds()
        self._check_demonstrations()
        self._check_learning()
        if self.algo in OFF_POLICY_BASELINES and self.learning_starts not in (None, self.warmup_steps):
            raise UserError(f"--algo {self.algo} learns from the end of --warmup_steps on; leave out --learning_starts")
        if self.algo in ("sb3-ddpg", "sb3-td3") and self.noise.kind == "pink":
            raise UserError(f"--algo {self.algo} has no pink noise; use --noise.kind gaussian or ou")
        if self.network.normalisation == "batch" and self.learner.batch_size == 1:
            raise UserError(
                "--network.normalisation batch has no deviation of --learner.batch_size 1; give a larger one"
            )
        if self.episode_steps < self.action_repeat:
            raise UserError(f"--episode_steps {self.episode_steps} is less than --action_repeat {self.action_repeat}")
        if self.success_bonus and self.replay.hindsight:
            raise UserError(
                f"--success_bonus {self.success_bonus} is no part of the rewards that --replay.hindsight "
                f"{self.replay.hindsight} computes; give one of them"
            )
        if self.replay.hindsight and self.action_repeat > 1:
            raise UserError(
                f"--replay.hindsight {self.replay.hindsight} computes the reward of a single step, and --action_repeat "
                f"{self.action_repeat} sums those of so many; give --action_repeat 1"
            )
        if self.echo_share and not self.retry_share:
            raise UserError(f"--echo_share {self.echo_share} is of retries; give --retry_share, too")
        if self.noise.retries != "first" and not self.retry_share:
            raise UserError(f"--noise.retries {self.noise.retries} is of retries; give --retry_share, too")
        if (held := self.noise.epsilon_z_retries) and not self.retry_share:
            raise UserError(f"--noise.epsilon_z_retries {held} is of retries; give --retry_share, too")

    def content(self) -> dict[str, Any]:
        """Return the keys that must not change when a run is resumed."""
        free = "out resume overwrite seeds workers backend env_steps episodes threads device checkpoint_every"
        free += " evaluation_every evaluation_episodes final_evaluation_episodes evaluation_to_end log_every loggers"
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in free.split()}

    def _check_learning(self) -> None:
        """Raise UserError if there would be no update; PPO has none of these keys."""
        for key in ("warmup_steps", "learning_starts"):
            if self.algo != "ppo" and (steps := getattr(self, key) or 0) >= self.env_steps:
                raise UserError(f"--{key} {steps} leaves nothing of --env_steps {self.env_steps} to learn in")
        if self.algo in BASELINES and self.replay.hindsight:
            raise UserError(f"--replay.hindsight is for --algo ddpg; {self.algo} of Stable-Baselines3 has none")
        if self.algo in BASELINES:
            return
        if self.replay.capacity < self.learner.batch_size:
            raise UserError(
                f"--replay.capacity {self.replay.capacity} never holds a batch of --learner.batch_size "
                f"{self.learner.batch_size}, so nothing would be learnt; give a larger memory or a smaller batch"
            )
        transitions = self.env_steps // self.action_repeat * (1 + self.replay.hindsight)
        if transitions < self.learner.batch_size:
            raise UserError(
                f"--env_steps {self.env_steps} with --action_repeat {self.action_repeat} bring {transitions} "
                f"transitions, fewer than --learner.batch_size {self.learner.batch_size}, so nothing would be learnt"
            )

    def _check_demonstrations(self) -> None:
        if not self.demonstrations:
            return
        if self.algo in BASELINES:
            raise UserError(f"--demonstrations is for --algo ddpg; {self.algo} of Stable-Baselines3 takes none")
        spent = self.demonstrations * self.episode_steps
        if spent + self.warmup_steps >= self.env_steps:
            raise UserError(
                f"--demonstrations {self.demonstrations} of {self.episode_steps} steps each and --warmup_steps "
                f"{self.warmup_steps} leave nothing of --env_steps {self.env_steps} to learn in"
            )

    def _check_seeds(self) -> None:
        check_backend(self.backend)
        if self.seeds and parse_seeds(self.seeds) and self.seed:
            raise UserError(f"--seeds {self.seeds} leaves no room for --seed {self.seed}; give one of them")
