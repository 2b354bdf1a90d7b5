"""``nerf-rl view RUN``: serve an agent's page, or save it."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nerf_rl.machine.devices import resolve_device
from nerf_rl.viewer.config import ViewConfig

if TYPE_CHECKING:
    from nerf_rl.viewer.drawing.slides import DrawSlide
    from nerf_rl.viewer.pages.agent import Agent


def serve_agent(config: ViewConfig) -> None:
    """Serve until Ctrl-C."""
    from nerf_rl.viewer.pages.agent_view import AgentView
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    agent = _agent(config)
    with serve(config.host, config.port, agent.title) as server:
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
        agent.title,
        _slides(agent, config.episodes),
        legend,
        lambda: learning_charts(agent.evaluations(), agent.metrics()),
    )


def _agent(config: ViewConfig) -> "Agent":
    from nerf_rl.viewer.pages.agent import Agent

    return Agent(Path(config.path), config.encoder, config.seed, config.episodes, resolve_device(config.device))


def _slides(agent: "Agent", episodes: int) -> list["DrawSlide"]:
    """Act the episodes; return a slide a step."""
    from nerf_rl.progress import Progress
    from nerf_rl.viewer.pages.agent_pictures import episode_slide

    slides: list[DrawSlide] = []
    with Progress(episodes, "episodes") as progress:
        for number in range(episodes):
            episode = agent.act(number)
            slides += [partial(episode_slide, agent, episode, step) for step in range(len(episode))]
            progress.advance()
    return slides
