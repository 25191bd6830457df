"""How networks multiply matrices while they learn."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

NATIVE = ("avx512_bf16", "amx_bf16")  # instructions that make bf16 the faster choice


@contextmanager
def fast_products(device: torch.device, bf16: bool = False) -> Iterator[None]:
    """Let torch multiply by oneDNN instead of the vendor's library, which is slow on other vendors' processors.

    Numbers stay in single precision, unless a device has matrix units for less: bf16 on some CPUs, TF32 on GPUs. With
    `bf16` products are taken in bf16 where the device has instructions for it; weights, losses and the optimizer's
    state keep single precision.
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        # nothing cached: weights change between one minibatch and the next
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16 and has_bf16(device), cache_enabled=False):
            yield
    finally:
        torch.set_float32_matmul_precision(before)


def has_bf16(device: torch.device) -> bool:
    """Return whether the device is known to multiply bf16 by instructions of its own."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    capabilities: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()  # newer versions of torch tell
    return any(capabilities.get(name, False) for name in NATIVE)
