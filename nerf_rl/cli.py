"""The command line: each sub-command is a function of one configuration dataclass.

Nothing heavy is imported until a sub-command is known and its arguments are valid, so help and mistakes answer at once.
"""

import dataclasses
import errno
import importlib
import sys
import traceback
from collections.abc import Sequence
from typing import Any

from nerf_rl import __version__
from nerf_rl.errors import FailureError, UnknownNameError, UserError
from nerf_rl.files.folder_lock import release_folders
from nerf_rl.machine.termination import Termination

_LONGEST_SENTENCE = 4000  # characters; lists of what is available are long


@dataclasses.dataclass(frozen=True)
class Command:
    """One sub-command: its configuration class and its function as ``module:name``, and a line of help.

    ``positional`` is the key that a word without one stands for; with ``+``, each word is appended to its list.
    """

    config: str
    function: str
    help: str
    positional: str = ""


COMMANDS = {
    "gen-dataset": Command(
        "nerf_rl.datasets.config:GenDatasetConfig",
        "nerf_rl.datasets.generation.generator:generate_dataset",
        "render a multi-view dataset (RGB, labels, depth, camera matrices) from a MuJoCo scene",
    ),
    "export": Command(
        "nerf_rl.datasets.export.config:ExportConfig",
        "nerf_rl.datasets.export.export:export",
        "write a dataset's frames as nerfstudio scenes, coloured point clouds or fused meshes",
        positional="dataset",
    ),
    "import": Command(
        "nerf_rl.datasets.importing.config:ImportConfig",
        "nerf_rl.datasets.importing.importer:import_dataset",
        "make a dataset of pictures with known cameras: nerfstudio scenes, or a LeRobotDataset",
        positional="source",
    ),
    "merge": Command(
        "nerf_rl.datasets.upkeep.config:MergeConfig",
        "nerf_rl.datasets.upkeep.merge:merge",
        "put the parts that gen-dataset --shard I/N rendered together into one dataset",
        positional="parts+",
    ),
    "check": Command(
        "nerf_rl.datasets.upkeep.config:CheckConfig",
        "nerf_rl.datasets.upkeep.check:check",
        "find every changed, missing or unusable file of a dataset, and render such shards again",
        positional="folder",
    ),
    "pretrain": Command(
        "nerf_rl.pretrain.config:PretrainConfig",
        "nerf_rl.pretrain.train:pretrain",
        "train the multi-view encoder through a latent-conditioned radiance field",
    ),
    "probe": Command(
        "nerf_rl.pretrain.config:ProbeConfig",
        "nerf_rl.pretrain.probe:probe",
        "measure what a frozen encoder's latent knows of the true state",
    ),
    "train-rl": Command(
        "nerf_rl.rl.config:TrainRLConfig",
        "nerf_rl.rl.train:train_rl",
        "train DDPG on the frozen latent plus proprioception, or on the true state",
    ),
    "evaluate": Command(
        "nerf_rl.rl.evaluate_config:EvaluateConfig",
        "nerf_rl.rl.evaluate:evaluate",
        "evaluate a trained policy, with video",
    ),
    "tune": Command(
        "nerf_rl.tuning.config:TuneConfig",
        "nerf_rl.tuning.tune:tune",
        "search train-rl's keys: whale optimisation, TPE, CMA-ES or random, on many processes and machines",
    ),
    "view": Command(
        "nerf_rl.viewer.config:ViewConfig",
        "nerf_rl.viewer.view:view",
        "look at a dataset, an encoder or an agent in the browser, or save it as a page, picture or video",
        positional="path",
    ),
    "report": Command(
        "nerf_rl.report.config:ReportConfig",
        "nerf_rl.report.report:write_report",
        "gather a dataset, an encoder and an agent into one self-contained HTML page",
    ),
    "push": Command(
        "nerf_rl.push.config:PushConfig",
        "nerf_rl.push.push:push",
        "put an encoder or an agent on the Hugging Face Hub, with a card, or into a folder",
        positional="run",
    ),
    "doctor": Command(
        "nerf_rl.doctor.config:DoctorConfig",
        "nerf_rl.doctor.doctor:doctor",
        "check that this machine has what is needed (rendering, torch, memory, disk), with a fix for what is not",
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; return 0, 1 (failure), 2 (the user's mistake), 130 (interrupted) or 143 (terminated)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_help())
        return 0 if arguments else 2
    if arguments[0] == "--version":
        print(f"nerf-rl {__version__}")
        return 0
    with Termination() as termination:
        return _run(arguments[0], arguments[1:], termination)


def _run(name: str, arguments: Sequence[str], termination: Termination) -> int:
    try:
        if name not in COMMANDS:
            raise UnknownNameError("command", name, COMMANDS)
        config = parse(name, arguments)
        _load(COMMANDS[name].function)(config)
    except (UserError, FailureError) as error:
        print(f"nerf-rl {name}: {_one_line(error)}", file=sys.stderr)
        return 2 if isinstance(error, UserError) else 1
    except KeyboardInterrupt:
        print(f"nerf-rl {name}: {'terminated' if termination.asked else 'interrupted'}", file=sys.stderr)
        return 143 if termination.asked else 130
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            print(f"nerf-rl {name}: {error.filename} is a longer name than the file system allows", file=sys.stderr)
            return 2
        traceback.print_exc()
        return 1
    finally:
        release_folders()
    return 0


def parse(name: str, arguments: Sequence[str]) -> Any:
    """Return the configuration of a sub-command from its arguments.

    Raises:
        UserError: an unknown key, a value of the wrong type or out of range, an unreadable recipe.
        SystemExit: after ``--help`` and ``--print_config``.
    """
    from nerf_rl.arguments.parsing import (
        parse_config,  # jsonargparse takes longer to import than `nerf-rl --help` may take
    )

    command = COMMANDS[name]
    return parse_config(_load(command.config), f"nerf-rl {name}", command.help, arguments, command.positional)


def _one_line(error: Exception) -> str:
    """Return an error's sentence on one line of readable length, whatever a damaged file has brought into it."""
    sentence = "".join(sign if sign.isprintable() else " " for sign in str(error))
    sentence = " ".join(sentence.split())
    half = _LONGEST_SENTENCE // 2
    return sentence if len(sentence) <= _LONGEST_SENTENCE else f"{sentence[:half]} ... {sentence[-half:]}"


def _load(target: str) -> Any:
    module, attribute = target.split(":")
    return getattr(importlib.import_module(module), attribute)


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.help}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "usage: nerf-rl COMMAND [--config FILE] [--key value ...]",
            "",
            "Perception-first robot learning on MuJoCo.",
            "",
            "commands:",
            *lines,
            "",
            "nerf-rl COMMAND --help lists a command's keys; --print_config prints its full recipe.",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
