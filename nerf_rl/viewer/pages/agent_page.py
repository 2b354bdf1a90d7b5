"""``nerf-rl view RUN``: serve an agent's page, or save it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from nerf_rl.machine.devices import resolve_device
from nerf_rl.viewer.config import ViewConfig

if TYPE_CHECKING:
    from nerf_rl.viewer.drawing.slides import Slide
    from nerf_rl.viewer.pages.agent import Agent


def serve_agent(config: ViewConfig) -> None:
    """Serve until Ctrl-C."""
    from nerf_rl.viewer.pages.agent_view import AgentView
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    agent = _agent(config)
    with serve(config.host, config.port, f"{agent.policy.spec.scene}: agent") as server:
        page = AgentView(server, agent)
        print(where_to_look(config.host, server.get_port()), flush=True)
        wait_for_interrupt()
        page.close()


def save_agent(config: ViewConfig) -> None:
    """Write the files asked for: the episodes step by step, and learning curves."""
    from nerf_rl.viewer.pages.agent_pictures import learning_charts
    from nerf_rl.viewer.pages.saving import save

    agent = _agent(config)
    legend = None
    if agent.field is not None:
        legend = agent.class_names, agent.palette
    save(
        config.files,
        f"{agent.policy.spec.scene}: agent",
        _slides(agent, config.episodes),
        legend,
        lambda: learning_charts(agent.evaluations(), agent.metrics()),
    )


def _agent(config: ViewConfig) -> "Agent":
    from nerf_rl.viewer.pages.agent import Agent

    return Agent(Path(config.path), config.encoder, config.seed, config.episodes, resolve_device(config.device))


def _slides(agent: "Agent", episodes: int) -> Iterator["Slide"]:
    from nerf_rl.progress import Progress
    from nerf_rl.viewer.pages.agent_pictures import episode_slide

    with Progress(episodes, "episodes") as progress:
        for number in range(episodes):
            episode = agent.act(number)
            for step in range(len(episode)):
                yield episode_slide(agent, episode, step)
            progress.advance()
