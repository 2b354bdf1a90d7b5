"""Stable-Baselines3's models from our keys, and their policies as ours."""

from fractions import Fraction
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from nerf_rl.machine.devices import resolve_device
from nerf_rl.rl.agents.networks import LayeredActor, LayeredConfig
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.agents.policy import make_actor
from nerf_rl.rl.config import NoiseConfig, TrainRLConfig

Model = PPO | TD3 | SAC  # DDPG is a TD3 to Stable-Baselines3
OFF_POLICY = {"sb3-ddpg": DDPG, "sb3-td3": TD3, "sb3-sac": SAC}
ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU}
CLIPPED_AT = 10.0  # VecNormalize's own limit of standardised observations


def make_model(config: TrainRLConfig, envs: VecEnv) -> Model:
    """Return an untrained model.

    PPO takes its keys from ``config.ppo``. DDPG, TD3 and SAC take what they have in common with our DDPG:
    ``network.hidden``, ``gamma``, ``tau``, ``critic_rate`` (for all networks), ``batch_size``, ``updates_per_step``,
    the replay's capacity and ``warmup_steps``; DDPG and TD3 the first scale of the noise (SB3's does not fall), while
    SAC draws its actions. They replay uniformly.
    """
    if config.algo == "ppo":
        ppo = config.ppo
        same = "n_steps batch_size n_epochs gamma gae_lambda learning_rate clip_range ent_coef vf_coef max_grad_norm"
        network = {
            "net_arch": ppo.hidden,
            "activation_fn": ACTIVATIONS[ppo.activation],
            "log_std_init": ppo.log_std_init,
        }
        keys = {name: getattr(ppo, name) for name in same.split()}
        return PPO(
            "MlpPolicy", envs, **keys, policy_kwargs=network, seed=config.seed, device=resolve_device(config.device)
        )
    learner, actions = config.learner, int(np.prod(envs.action_space.shape or ()))
    noise = None if config.algo == "sb3-sac" else _noise(config.noise, actions)
    each = Fraction(learner.updates_per_step * envs.num_envs).limit_denominator(1_000_000)  # step of all environments
    return OFF_POLICY[config.algo](
        "MlpPolicy",
        envs,
        learning_rate=learner.critic_rate,
        buffer_size=config.replay.capacity,
        learning_starts=config.warmup_steps // config.action_repeat,
        batch_size=learner.batch_size,
        tau=learner.tau,
        gamma=learner.gamma,
        train_freq=each.denominator,
        gradient_steps=each.numerator,
        action_noise=noise,
        policy_kwargs={"net_arch": config.network.hidden},
        seed=config.seed,
        device=resolve_device(config.device),
    )


def _noise(config: NoiseConfig, actions: int) -> ActionNoise:
    """Return noise of our own agent's kind and size; of Ornstein and Uhlenbeck's, whose size is in the long run."""
    mean, scale = np.zeros(actions), np.full(actions, config.start)
    if config.kind == "gaussian":
        return NormalActionNoise(mean, scale)
    step = scale * np.sqrt(1.0 - (1.0 - config.theta) ** 2)
    return OrnsteinUhlenbeckActionNoise(mean, step, theta=config.theta, dt=1.0)


def layered_config(config: TrainRLConfig) -> LayeredConfig:
    """Return what the exported policy's network is made of."""
    if config.algo == "ppo":
        limit = CLIPPED_AT if config.ppo.normalise else None
        return LayeredConfig(config.ppo.hidden, config.ppo.activation, "clip", limit)
    return LayeredConfig(config.network.hidden, "relu", "tanh", None)


def export_actor(model: Model, config: TrainRLConfig) -> nn.Sequential:
    """Return a copy of the model's deterministic policy, from raw observation [B, O] to action [B, A]."""
    observation_size = int(np.prod(model.observation_space.shape or ()))
    action_size = int(np.prod(model.action_space.shape or ()))
    exported = make_actor(observation_size, action_size, layered_config(config))
    norm, actor = exported
    assert isinstance(norm, RunningNorm) and isinstance(actor, LayeredActor)
    policy: Any = model.policy
    if isinstance(model, PPO):
        layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    else:  # SAC's actor has its mean apart from the layers below, which its deviation shares
        layers = [*policy.actor.latent_pi, policy.actor.mu] if isinstance(model, SAC) else policy.actor.mu
    sources = [layer for layer in layers if isinstance(layer, nn.Linear)]
    targets = [layer for layer in actor.layers if isinstance(layer, nn.Linear)]
    for source, target in zip(sources, targets, strict=True):
        target.load_state_dict(source.state_dict())
    normaliser = model.get_vec_normalize_env()
    if normaliser is not None:
        statistics: Any = normaliser.obs_rms
        norm.count.fill_(statistics.count)
        norm.mean.copy_(torch.as_tensor(statistics.mean))
        norm.squares.copy_(torch.as_tensor((statistics.var + normaliser.epsilon) * statistics.count))
    return exported.eval().requires_grad_(False)
