"""What the pages show and no test can run, each with the reason; everything else is run."""

LINES = {
    ". .venv/bin/activate": "the tests run in this environment already",
    "pip install .[hub]": "needs the internet; that there is such an extra is tested",
    "pip install .[dm_control]": "needs the internet; that there is such an extra is tested",
    "pip install .[panda]": "needs the internet; that there is such an extra is tested",
    "pip install .[sb3]": "needs the internet; that there is such an extra is tested",
    "nerf-rl push runs/encoder --to USER/NAME --licence mit": "goes to the Hub; tested on a local server in tests/hub",
    "nerf-rl push runs/agent --to USER/NAME --controls [runs/agent-blind, runs/agent-random]": "the same",
    "nerf-rl train-rl --encoder hf://USER/NAME --out runs/agent": "the same, from the Hub",
    "nerf-rl train-rl --encoder hf://USER/NAME@COMMIT --out runs/agent": "the same",
    "nerf-rl evaluate --run hf://USER/NAME --out runs/evaluation": "the same",
    "python -m rl_zoo3.plots.plot_train -a ddpg -e drawer-open -f runs -y success": (
        "a program of others, which no extra installs; tests/rl/training/test_zoo_files.py reads the files as it does"
    ),
    "python -m rl_zoo3.plots.all_plots -a ddpg -e drawer-open -f runs": "the same",
    "pip install optuna-dashboard": "needs the internet",
    "optuna-dashboard runs/tune/study.journal": "a program of others, which no extra installs",
    "nerf-rl doctor": "takes half a minute, and is run as a whole in tests/doctor/test_doctor.py",
    "nerf-rl pretrain ... --devices 2": "run on two processes in tests/pretrain/execution/test_pretrain_devices.py",
    "torchrun --nproc-per-node 2 -m nerf_rl pretrain ... --devices 2": "the same under another launcher",
    "srun --nodes 2 --ntasks-per-node 4 --gpus-per-node 4 nerf-rl pretrain ... --devices 4 --nodes 2": "a cluster's",
    "nerf-rl tune --config rl/tune.yaml --storage mysql://user:password@host/tune --study drawer --out runs/tune": (
        "needs a database server"
    ),
}
"""Commands, spaced by one blank and without comments and quotes. Those of nerf-rl are parsed all the same."""

TEXTS = {
    "z = h(mean_i g(CNN(o_i), K_i))": "a formula",
}
"""Blocks that are neither commands nor Python, by how they begin."""

LISTINGS = {
    "encoder.safetensors, encoder.json": "runs/encoder",
    "manifest.json": "data/drawer",
}
"""Listings of a folder, by how they begin, with a folder that is compared with them."""
UNFINISHED = {"unfinished.json", "parts/2-of-8/"}
"""what is listed and in no finished folder"""
