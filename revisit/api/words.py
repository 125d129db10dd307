"""Words that service, SDK and commands say alike."""

from __future__ import annotations

KERNELS = "the first worker here compiles its kernels: half a minute on a free core; later starts load them"
NO_WORKER = (
    "no worker is ready: what is posted waits, and no query by cloud is answered. Either it is still starting "
    f"({KERNELS}), or the service's log says why it ends"
)
