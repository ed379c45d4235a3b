"""Pods of Kubernetes: what the operator is asked for, and what is refused before."""

import http.client
import json
import os
import re
import subprocess
import sys

import dask
import pytest

from jaxscan.errors import OptionError
from jaxscan.fleet import ClusterChoice
from jaxscan.fleet.clusters.kubernetes import cluster_spec, configured_image


CHOICE = ClusterChoice(kubernetes=True, workers=7, memory_gib=6.5)


def spec():
    return cluster_spec("jaxscan-01", "registry.example/jaxscan:1", CHOICE)


def containers(found):
    return {part: found["spec"][part]["spec"]["containers"] for part in ("worker", "scheduler")}


def test_it_asks_for_workers_and_memory_in_plain_values():
    found = spec()
    assert json.loads(json.dumps(found)) == found
    assert found["metadata"] == {"name": "jaxscan-01"}
    assert found["spec"]["worker"]["replicas"] == 7
    (worker,), (scheduler,) = containers(found).values()
    assert worker["image"] == scheduler["image"] == "registry.example/jaxscan:1"
    assert worker["resources"] == {"requests": {"memory": "6656Mi"}, "limits": {"memory": "6656Mi"}}
    command = " ".join(worker["command"])
    assert command.startswith("dask worker --name $(DASK_WORKER_NAME) --nthreads 1 --memory-limit 6656MiB")
    assert {"name": "DASK_DISTRIBUTED__WORKER__MEMORY__SPILL", "value": "False"} in worker["env"]


def test_nothing_is_open_to_the_outside():
    found = spec()
    assert found["spec"]["scheduler"]["service"]["type"] == "ClusterIP"
    for (container,) in containers(found).values():
        assert not container["securityContext"]["allowPrivilegeEscalation"]
    assert not any(found["spec"][part]["spec"]["automountServiceAccountToken"] for part in containers(found))


@pytest.mark.rig
def test_pages_answer_to_nothing_but_the_probe():
    (worker,), (scheduler,) = containers(spec()).values()
    assert "--no-dashboard" in scheduler["command"] and scheduler["livenessProbe"]["httpGet"]["path"] == "/health"
    assert worker["command"][-2:] == ["--preload", "jaxscan.fleet.clusters.no_page"]
    variables = {variable["name"]: variable["value"] for variable in scheduler["env"]}
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    command += ["--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    environment = {**os.environ, **variables, "DASK_CONFIG": os.devnull}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        try:
            found = next(filter(None, (re.search(r"dashboard at:.*:(\d+)/", line) for line in process.stderr)))
            statuses = {}
            for path in ("/health", "/info/main/workers.html", "/json/identity.json", "/status", "/metrics"):
                asking = http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=30.0)
                asking.request("GET", path)
                statuses[path] = asking.getresponse().status
                asking.close()
        finally:
            process.kill()
    assert statuses.pop("/health") == 200
    assert set(statuses.values()) == {404}, statuses


def test_the_operator_reads_it_as_its_own():
    """The same parts under the same names as in a cluster that dask-kubernetes describes by itself."""
    operator = pytest.importorskip("dask_kubernetes.operator", reason="the extra `kubernetes` is not installed")
    theirs, ours = operator.make_cluster_spec("jaxscan-01", n_workers=7), spec()
    assert {key: theirs[key] for key in ("apiVersion", "kind", "metadata")} == {
        key: ours[key] for key in ("apiVersion", "kind", "metadata")
    }
    assert ours["spec"]["scheduler"]["service"] == theirs["spec"]["scheduler"]["service"]
    for part, (container,) in containers(ours).items():
        assert ours["spec"][part].keys() == theirs["spec"][part].keys()
        assert container["name"] == containers(theirs)[part][0]["name"]
    ports = [{k: port[k] for k in ("name", "containerPort")} for port in containers(theirs)["scheduler"][0]["ports"]]
    assert containers(ours)["scheduler"][0]["ports"] == ports
    from dask_kubernetes.operator.controller.controller import build_worker_deployment_spec

    made = build_worker_deployment_spec(
        worker_group_name="w",
        namespace="n",
        cluster_name="jaxscan-01",
        uuid="1",
        pod_spec=ours["spec"]["worker"]["spec"],
        annotations={},
        labels={},
    )
    (worker,) = made["spec"]["template"]["spec"]["containers"]
    assert {"DASK_WORKER_NAME", "DASK_SCHEDULER_ADDRESS"} < {variable["name"] for variable in worker["env"]}


def test_an_image_must_be_chosen():
    with dask.config.set({"kubernetes.image": "ghcr.io/dask/dask:latest"}):
        with pytest.raises(OptionError, match="set DASK_KUBERNETES__IMAGE"):
            configured_image()
    with dask.config.set({"kubernetes.image": " "}), pytest.raises(OptionError, match="no image is chosen"):
        configured_image()
    with dask.config.set({"kubernetes.image": "mine:1"}):
        assert configured_image() == "mine:1"
