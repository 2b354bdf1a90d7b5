"""``nerf-rl push``: an encoder or an agent as a folder with a card, on the Hub or on this machine."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from nerf_rl.errors import MissingFileError, OutputExistsError, UserError
from nerf_rl.files.atomic import write_text
from nerf_rl.files.outputs import making, require_place
from nerf_rl.hub.commit import commit_folder
from nerf_rl.machine.extras import import_extra
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION
from nerf_rl.push.agent_card import agent_card, read_control
from nerf_rl.push.artefact import write_agent, write_encoder, write_summary
from nerf_rl.push.card import CARD, Naming
from nerf_rl.push.config import PushConfig
from nerf_rl.push.encoder_card import encoder_card
from nerf_rl.push.picture import write_picture
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION
from nerf_rl.rl.training.evaluation_results import read_evaluations


def push(config: PushConfig) -> None:
    """Write what others get of a run, and commit it to the Hub if it is to go there.

    Raises:
        UserError: nothing to push, nowhere to push to, a folder in use, or the Hub refuses.
    """
    run, address = Path(config.run), config.address
    if address is None and not config.out:
        raise UserError("say where: --to USER/NAME pushes to the Hub, --out FOLDER writes what would be pushed")
    is_agent = (run / POLICY_DESCRIPTION).is_file()
    if not is_agent and not (run / DESCRIPTION).is_file():
        expected = "give a run folder of pretrain that has ended, or of train-rl; of several seeds, the folder of one"
        raise MissingFileError(
            "an encoder or an agent", run, f"it holds no {DESCRIPTION} and no {POLICY_DESCRIPTION}", expected
        )
    if config.controls and not is_agent:
        raise UserError("--controls stand beside an agent's success rate; an encoder has none")
    if address is not None:
        import_extra("huggingface_hub", "hub", "push --to")
    with _folder(config.out) as folder:
        (_write_agent if is_agent else _write_encoder)(config, run, folder)
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            print(f"{path.stat().st_size / 1024:10,.1f} kB  {path.relative_to(folder)}")
        if address is not None:
            kind, unlike = ("agent", DESCRIPTION) if is_agent else ("encoder", POLICY_DESCRIPTION)
            pushed = commit_folder(folder, address, config.private, f"Upload {kind} with nerf-rl", unlike)
            print(f"pushed as {pushed}")
    if config.out:
        print(f"{config.out} holds what {'was' if address else 'would be'} pushed")


def _write_encoder(config: PushConfig, run: Path, folder: Path) -> None:
    description = write_encoder(run, folder)
    summary = write_summary(run, folder)
    pictured = write_picture(run, folder)
    write_text(folder / CARD, encoder_card(_naming(config, pictured), description, summary))


def _write_agent(config: PushConfig, run: Path, folder: Path) -> None:
    description, encoder = write_agent(run, folder, config.encoder)
    controls = [read_control(Path(control), description) for control in config.controls]
    evaluations = read_evaluations(run)
    summary = write_summary(run, folder)
    naming = _naming(config, write_picture(run, folder))
    write_text(folder / CARD, agent_card(naming, description, encoder, summary, evaluations, controls))


def _naming(config: PushConfig, pictured: bool) -> Naming:
    """Return what a card calls its artefact: its name on the Hub, or that of the folder."""
    if config.address is not None:
        return Naming(config.address.repository, str(config.address), config.licence, pictured)
    name = Path(config.out).resolve().name
    return Naming(name, name, config.licence, pictured)


@contextlib.contextmanager
def _folder(out: str) -> Iterator[Path]:
    """Give an empty folder to write to; what it holds goes where it is to stay, if anywhere, once it is whole.

    Much is found out while it is written: a refusal, or an interruption, leaves nothing that the next try meets.
    """
    if not out:
        with tempfile.TemporaryDirectory() as temporary:
            yield Path(temporary)
        return
    folder = Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExistsError(folder, "use another --out, or delete it")
    with making(folder):
        partial = tempfile.TemporaryDirectory(prefix=".partial-", dir=require_place(folder))
    with partial as beside:
        yield Path(beside)
        folder.mkdir(parents=True, exist_ok=True)
        for path in Path(beside).iterdir():
            path.rename(folder / path.name)
