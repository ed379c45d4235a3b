"""Stripes and clouds on an accelerator: differences from the CPU, and speed.

Frames begin and clouds end in the host's memory, as a user has them. The least time of some runs after one to compile,
and the results of both devices field by field, where both are valid.

    python -m experiments.gpu_speed [--dry] [--pairs 1024] [--json FILE]

Without an accelerator --dry runs everything on the CPU with few pairs, to see that it works: the times then mean
nothing, and both sides of a difference are computed there.
"""

import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from experiments.report import Figure, command_line, conclude
from experiments.speed import take_turns
from experiments.speed_scene import DISTINCT, ELECTRONS_PER_DN, READ_DN, make_angles, make_frames, make_scanner
from jaxscan.reconstruction import Sweep, reconstruct
from jaxscan.stripes import NoiseModel, extract_stripes


NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
LIMIT_SIGMAS = 0.1
"""Largest difference of nearly all centres from the CPU's, in their standard deviations."""
NEARLY_ALL = 0.999
LIMIT_ONE_SIDED = 1e-3
"""Share of the stripes that only one of two results may have."""
UNITS = {"u": "px", "sigma": "px", "width": "px", "amplitude": "DN", "rgb": "DN", "intensity": "DN"}
UNITS |= {"xyz": "m", "sigma_random": "m", "sigma_systematic": "m"}


def differences(name: str, found: Any, expected: Any) -> list[Figure]:
    """How far the fields of two results are apart where both are valid, and where only one is."""
    here, there = (
        {key: np.asarray(field) for key, field in vars(one).items() if field is not None} for one in (found, expected)
    )
    both, figures = here["valid"] & there["valid"], []
    for key in UNITS.keys() & here.keys() & there.keys():
        apart = np.abs(here[key][both].astype(np.float64) - there[key][both].astype(np.float64))
        figures.append(Figure(f"{name}, {key}: largest", float(apart.max(initial=0.0)), UNITS[key]))
        if key == "u" and apart.size:
            scaled = float(np.quantile(apart / there["sigma"][both], NEARLY_ALL))
            figures.append(Figure(f"{name}, u: nearly all, in sigmas", scaled, "1", high=LIMIT_SIGMAS))
    alone = np.count_nonzero(here["valid"] != there["valid"]) / max(np.count_nonzero(there["valid"]), 1)
    return [
        *sorted(figures),
        Figure(f"{name}: valid in both", float(np.count_nonzero(both)), "lines"),
        Figure(f"{name}: valid in one only", float(alone), "1", high=LIMIT_ONE_SIDED),
    ]


def measure(device: jax.Device, pairs: int, repeats: int) -> list[Figure]:
    """Stripes and clouds of so many pairs on a device, and those of the distinct pairs on the CPU."""
    scanner, frames, cpu = make_scanner(), make_frames(pairs, make_scanner()), jax.devices("cpu")[0]
    some = slice(0, min(DISTINCT, pairs))
    works: dict[str, Callable[[slice], Any]] = {
        "stripes": lambda part: extract_stripes(frames.on[part], frames.off[part], noise=NOISE),
        "clouds": lambda part: reconstruct(
            Sweep(frames.on[part], frames.off[part], make_angles(pairs)[part]), scanner, noise=NOISE
        ),
    }
    figures = []
    for name, work in works.items():
        with jax.default_device(device):
            run = lambda work=work: jax.block_until_ready(vars(work(slice(None))))
            taken, found = take_turns({name: run}, repeats)[name].best, work(some)
        with jax.default_device(cpu):
            expected = work(some)
        figures.append(Figure(name, 1e6 * taken / pairs, "us/pair"))
        figures += differences(f"{name} - CPU", found, expected)
    return figures


def main() -> int:
    """Print the figures; exit code 1 if one misses its limit."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--dry", action="store_true", help="on the CPU, few pairs")
    parser.add_argument("--pairs", type=int, default=1024)
    options = parser.parse_args()
    device = jax.devices("cpu" if options.dry else None)[0]
    if device.platform == "cpu" and not options.dry:
        print("No accelerator is there; --dry runs on the CPU.", file=sys.stderr)
        return 1
    figures = measure(device, 16 if options.dry else options.pairs, 1 if options.dry else 7)
    print(f"{device.device_kind} ({device.platform})")
    return conclude("gpu-speed", figures, options.json, device=device.device_kind, dry=options.dry)


if __name__ == "__main__":
    sys.exit(main())
