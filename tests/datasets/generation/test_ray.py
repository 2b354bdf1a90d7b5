"""The same dataset from a Ray cluster of two nodes, started here."""

import subprocess
import sys
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS

ON_A_CLUSTER = """
import os, signal, sys, threading, time
from pathlib import Path
from ray.cluster_utils import Cluster
from nerf_rl.datasets.storage.shards import partial_files

def kill_the_first_worker_that_writes():
    while not (found := partial_files(Path(sys.argv[-1]), range(2))):
        time.sleep(0.005)
    _, process = next(iter(found.values()))
    os.kill(process, signal.SIGKILL)
    print("killed a worker")

cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
cluster.add_node(num_cpus=1)
os.environ["RAY_ADDRESS"] = cluster.address
threading.Thread(target=kill_the_first_worker_that_writes, daemon=True).start()
try:
    import ray
    from nerf_rl import cli

    code = cli.main(["gen-dataset", *sys.argv[1:], "--backend", "ray", "--workers", "2"])
    nodes = sum(node["Alive"] for node in ray.nodes())
    print(f"exit code {code} with {nodes} nodes")
finally:
    ray.shutdown()
    cluster.shutdown()
"""


def test_two_nodes_of_a_ray_cluster_write_the_same_bytes_though_a_worker_is_killed(
    tiny_dataset: Path, tiny_recipe: Path, tmp_path: Path
) -> None:
    pytest.importorskip("ray", reason="the extra 'ray' is not installed")
    arguments = ["--config", str(tiny_recipe), "--out", str(tmp_path / "data")]
    finished = subprocess.run(
        [sys.executable, "-c", ON_A_CLUSTER, *arguments], capture_output=True, text=True, timeout=900
    )
    assert "exit code 0 with 2 nodes" in finished.stdout, finished.stderr
    assert "killed a worker" in finished.stdout and "will be rendered anew" in finished.stdout
    for file in (f"{SHARDS}/000000.h5", f"{SHARDS}/000001.h5", MANIFEST):
        assert (tmp_path / "data" / file).read_bytes() == (tiny_dataset / file).read_bytes()


def test_a_backend_that_there_is_not_is_answered_with_those_there_are(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset", "--out", "x", "--backend", "rai"]) == 2
    assert "unknown backend 'rai' (did you mean ray?); available: local, ray" in capsys.readouterr().err


def test_ray_is_imported_by_no_other_path():
    modules = ("generation.generator", "upkeep.check", "upkeep.merge")
    imports = "; ".join(f"import nerf_rl.datasets.{module}" for module in modules)
    program = f"import sys; {imports}; sys.exit('ray' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
