import pytest
import torch

from racerl.train.products import fast_products, has_bf16

CPU = torch.device("cpu")


def product(bf16):
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(256, 256, generator=generator) for _ in range(2))
    with fast_products(CPU, bf16):
        return left @ right, left.double() @ right.double()


def test_single_precision_stays_single_precision():
    if torch.cpu.get_capabilities().get("amx_bf16", False):
        pytest.skip("this processor has matrix units for bf16, which torch is told to use")
    got, exact = product(bf16=False)
    assert got.dtype == torch.float32
    assert torch.allclose(got.double(), exact, rtol=0.0, atol=1e-4)


def test_bf16_is_used_where_the_processor_has_it_and_only_there():
    got, exact = product(bf16=True)
    assert (got.dtype == torch.bfloat16) == has_bf16(CPU)
    assert torch.allclose(got.double(), exact, rtol=0.01, atol=0.5)


def test_without_native_bf16_single_precision_is_used(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_f": True})
    got, _ = product(bf16=True)
    assert got.dtype == torch.float32


def test_the_rest_of_the_process_multiplies_as_before():
    before = torch.get_float32_matmul_precision()
    with pytest.raises(ZeroDivisionError), fast_products(CPU, bf16=True):
        1 / 0  # noqa: B018
    assert torch.get_float32_matmul_precision() == before
    assert not torch.is_autocast_enabled("cpu")
