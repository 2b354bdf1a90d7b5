"""Signs of a network that has stopped learning."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerf_rl.rl.agents.networks import Actor, Critic

_FLAT = 0.99  # |tanh| beyond which its slope is less than 2 %


def diagnose(actor: Actor, critic: Critic, observation: Float[Tensor, "B O"]) -> dict[str, float]:
    """Return signs of trouble on standardised observations.

    ``saturated``: share of action components on the flat ends of tanh, where the actor hardly learns. ``dead_units``:
    share of hidden units, of actor and critic, that are zero for all observations (Lyle et al. 2022; Sokar et al. 2023
    at threshold zero). ``action_gradient``: mean length of dQ/da, which is all that the actor learns from.
    """
    shares: list[Tensor] = []

    def count_dead(_: nn.Module, __: tuple[Tensor], output: Tensor) -> None:
        shares.append((output == 0).all(0).float())

    hooks = [m.register_forward_hook(count_dead) for n in (actor, critic) for m in n.modules() if type(m) is nn.ReLU]
    try:
        action = actor(observation).detach().requires_grad_(True)
        (gradient,) = torch.autograd.grad(critic(observation, action).sum(), action)
    finally:
        for hook in hooks:
            hook.remove()
    return {
        "saturated": (action.detach().abs() > _FLAT).float().mean().item(),
        "dead_units": torch.cat(shares).mean().item(),
        "action_gradient": gradient.norm(dim=-1).mean().item(),
    }
