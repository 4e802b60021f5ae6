"""Weights on disk: safetensors, with the network's settings and history as JSON beside them."""

import json

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from physics.errors import InputError
from physics.machinery.whole_file import whole_file

from ..network import TeXNet


def save_network(network, path, history):
    """Write a TeXNet; history is a dict of plain values that describes its origin. InputError if
    its weights are not all finite."""
    if not _finite(network):
        raise InputError(
            f"cannot write {path}: training diverged, the weights are not finite; take another "
            "seed."
        )
    about = {"config": json.dumps(network.config), "history": json.dumps(history)}
    with whole_file(path) as part:
        # save_file would create a file that nobody else may read
        part.write_bytes(save({n: p.contiguous() for n, p in network.state_dict().items()}, about))


def load_network(path):
    """(TeXNet, history) from a file; InputError if it is not one of weights."""
    try:
        with safe_open(path, "pt") as file:
            about = file.metadata() or {}
            network = TeXNet(**json.loads(about["config"]))
            network.load_state_dict({name: file.get_tensor(name) for name in file.keys()})
            history = json.loads(about["history"])
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as e:
        reason = "it is not a safetensors file that texnet wrote"
        if isinstance(e, OSError):  # safetensors leaves out strerror
            reason = e.strerror or "there is no such file, or it may not be read"
        raise InputError(f"model: cannot read {path}: {reason}.") from e
    if not _finite(network):
        raise InputError(f"model: cannot use {path}: its weights are not finite; train it again.")
    return network.eval(), history


def _finite(network):
    return all(p.isfinite().all() for p in network.state_dict().values())
