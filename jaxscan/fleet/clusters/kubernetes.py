"""Workers as pods of Kubernetes, by the operator of dask-kubernetes."""

import asyncio
import contextlib
import secrets
from collections.abc import Iterator
from typing import Any

import dask
import distributed

from jaxscan.errors import OptionError
from jaxscan.fleet.clusters.choice import ClusterChoice, patience_of
from jaxscan.fleet.clusters.settings import (
    LOOPBACK_PAGE,
    MEMORY,
    NO_PAGE,
    PAGELESS,
    as_environment,
    run_apart,
    wait_for_worker,
)


ANSWER_S = 20.0
"""How long Kubernetes may take to answer."""
_MEMORY_GIB = 4.0
_SCHEDULER_MEMORY = "2Gi"
_NOT_OURS = "ghcr.io/dask/dask"
"""The image that Dask's configuration has where nobody chose one; there is no jaxscan in it."""


@contextlib.contextmanager
def open_kubernetes(choice: ClusterChoice) -> Iterator[Any]:
    """A scheduler and workers as pods, which are deleted when `with` ends.

    Raises:
        OptionError: If no image is configured, Kubernetes does not answer, or no pod starts within an hour.
    """
    # Registers its part of Dask's configuration.
    from dask_kubernetes.operator import KubeCluster

    spec = cluster_spec(f"jaxscan-{secrets.token_hex(4)}", configured_image(), choice)
    try:
        run_apart(asyncio.wait_for(_greet(), ANSWER_S))
        cluster = KubeCluster(custom_cluster_spec=spec, namespace=dask.config.get("kubernetes.namespace"), quiet=True)
    # The libraries below it have no one error: no configuration, no network, no right, no operator.
    except Exception as problem:
        said = " ".join(f"{type(problem).__name__}: {problem}".split())
        raise OptionError(
            f"--kubernetes: no cluster was made ({said:.300}); look at kubectl cluster-info, "
            "and whether the operator of dask-kubernetes is installed."
        ) from problem
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        wait_for_worker(client, patience_of(choice), "look at kubectl get pods.")
        yield client


async def _greet() -> None:
    """Ask Kubernetes for its version: a cluster that cannot be made would be looked for again at the end."""
    import kr8s.asyncio

    await (await kr8s.asyncio.api()).version()


def configured_image() -> str:
    """The container image of scheduler and workers, from Dask's configuration or `DASK_KUBERNETES__IMAGE`.

    Raises:
        OptionError: If none is chosen.
    """
    image = dask.config.get("kubernetes.image", None)
    if not isinstance(image, str) or not image.strip() or image.startswith(_NOT_OURS):
        raise OptionError(
            "--kubernetes: no image is chosen; set DASK_KUBERNETES__IMAGE to one that has jaxscan[fleet] installed."
        )
    return image


def cluster_spec(name: str, image: str, choice: ClusterChoice) -> dict[str, Any]:
    """The resource `DaskCluster` that the operator makes pods of, as plain values.

    Each worker does one task at a time on all cores of its pod. A pod asks for its memory and may have no more, so a
    machine never swaps; the nanny in it ends the worker a little earlier.

    Args:
        name: Of the cluster.
        image: With jaxscan in it.
        choice: How many workers, and how much memory for each.
    """
    memory = f"{round((choice.memory_gib or _MEMORY_GIB) * 1024)}Mi"
    environment = [{"name": key, "value": value} for key, value in as_environment({**MEMORY, **PAGELESS}).items()]
    no_page = ["--no-dashboard", "--dashboard-address", LOOPBACK_PAGE, "--preload", NO_PAGE]
    worker = ["dask", "worker", "--name", "$(DASK_WORKER_NAME)", "--nthreads", "1", "--memory-limit", f"{memory}B"]
    # The probes of Kubernetes come from outside the pod, so the scheduler's HTTP listens. It answers only to them.
    only_health = as_environment({"distributed.scheduler.http.routes": ["distributed.http.health"]})
    ports = {"tcp-comm": 8786, "http-dashboard": 8787}
    probe = {"httpGet": {"port": "http-dashboard", "path": "/health"}}
    return {
        "apiVersion": "kubernetes.dask.org/v1",
        "kind": "DaskCluster",
        "metadata": {"name": name},
        "spec": {
            "worker": {
                "replicas": choice.workers or 1,
                "spec": _pod(_container("worker", image, [*worker, *no_page], memory, env=environment)),
            },
            "scheduler": {
                "spec": _pod(
                    _container(
                        "scheduler",
                        image,
                        ["dask", "scheduler", "--host", "0.0.0.0", "--no-dashboard"],
                        _SCHEDULER_MEMORY,
                        env=[{"name": key, "value": value} for key, value in only_health.items()],
                        ports=[{"name": key, "containerPort": port} for key, port in ports.items()],
                        readinessProbe={**probe, "periodSeconds": 1, "timeoutSeconds": 300},
                        livenessProbe={**probe, "initialDelaySeconds": 15, "periodSeconds": 20},
                    )
                ),
                "service": {
                    # An address within the Kubernetes cluster only.
                    "type": "ClusterIP",
                    "selector": {"dask.org/cluster-name": name, "dask.org/component": "scheduler"},
                    "ports": [
                        {"name": key, "protocol": "TCP", "port": port, "targetPort": key} for key, port in ports.items()
                    ],
                },
            },
        },
    }


def _pod(container: dict[str, Any]) -> dict[str, Any]:
    # What runs in it has no right to ask Kubernetes for anything.
    return {"containers": [container], "automountServiceAccountToken": False}


def _container(name: str, image: str, command: list[str], memory: str, **more: Any) -> dict[str, Any]:
    resources = {"requests": {"memory": memory}, "limits": {"memory": memory}}
    security = {"allowPrivilegeEscalation": False}
    return {
        "name": name,
        "image": image,
        "command": command,
        "resources": resources,
        "securityContext": security,
        **more,
    }
