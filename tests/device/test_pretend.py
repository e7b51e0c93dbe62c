"""The pretend device finds what a GPU would refuse: faults planted one by one are caught, and sound code is not."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import torch

from tests.device import pretend, rasterization
from tests.device.pretend import DeviceTensor, MixedDevicesError, counted


@pytest.fixture
def device() -> str:
    if not pretend.can_be_registered():
        pytest.skip("there is a GPU, so nothing is pretended")
    return pretend.register()


def test_arithmetic_and_gradients_are_those_of_the_cpu(device: str) -> None:
    given = torch.randn(6, 3, generator=torch.Generator().manual_seed(0))
    here, there = given.clone().requires_grad_(), given.to(device).requires_grad_()
    for leaf in (here, there):
        rows = torch.arange(0, 6, 2, device=leaf.device)
        (leaf[rows].square().sum() + torch.eye(3, device=leaf.device).mul(leaf[:3]).sum()).backward()  # type: ignore[no-untyped-call]
    assert isinstance(there.grad, DeviceTensor)
    assert there.grad.device.type == device
    assert here.grad is not None
    assert torch.equal(there.grad.cpu(), here.grad)


@pytest.mark.parametrize(
    "fault",
    [
        lambda x: x + torch.ones(3),  # a tensor made on the wrong device
        lambda x: torch.cat([x, torch.zeros(3)]),
        lambda x: x[torch.tensor([0, 1])] + x.cpu()[:2],
        lambda x: torch.where(torch.ones(3, dtype=torch.bool), x, x),
    ],
)
def test_mixing_devices_is_refused(device: str, fault: object) -> None:
    assert callable(fault)
    with pytest.raises(MixedDevicesError, match="mixes"):
        fault(torch.zeros(3, device=device))


@pytest.mark.parametrize("fault", [lambda x: x.numpy(), np.asarray, lambda x: np.add(x, 1)])
def test_numpy_of_device_memory_is_refused(device: str, fault: object) -> None:
    assert callable(fault)
    with pytest.raises((RuntimeError, TypeError)):
        fault(torch.zeros(3, device=device))


def test_numbers_may_mix(device: str) -> None:
    assert float((torch.ones(3, device=device) * torch.tensor(2.0)).sum()) == 6


@pytest.mark.parametrize(
    ("wait", "name"),
    [
        (lambda x: x.sum().item(), "_local_scalar_dense"),
        (lambda x: bool((x > 0).any()), "_local_scalar_dense"),
        (lambda x: x[x > 0], "index"),
        (lambda x: x.nonzero(), "nonzero"),
        (lambda x: x.cpu(), "_to_copy"),
        (lambda x: x.tolist(), "_to_copy"),
        (lambda x: x + torch.ones(5).to(x.device), "_to_copy"),
        (lambda x: x.copy_(torch.ones(5)), "copy_"),
    ],
)
def test_what_the_host_waits_for_is_counted(device: str, wait: object, name: str) -> None:
    assert callable(wait)
    values = torch.rand(5, device=device)
    with counted() as counts:
        values.mul(2).add(1)
    assert (sum(counts.launches.values()), sum(counts.waits.values())) == (2, 0)
    with counted() as counts:
        wait(values)
    assert any(name in operation for operation in counts.waits), counts.waits


def test_copies_that_nobody_waits_for_and_memory_alone_are_no_waits_and_no_launches(device: str) -> None:
    with counted() as counts:
        sent = torch.ones(5).to(device, non_blocking=True)
        torch.empty_like(sent)
        sent[1:3].detach().view(2, 1)
    assert counts.waits == {}
    assert sum(counts.launches.values()) == 1


def test_a_copy_to_the_host_holds_its_numbers_once_an_event_after_it_was_waited_for(device: str) -> None:
    numbers = torch.arange(5.0, device=device)
    with counted() as counts:
        copy = numbers.to("cpu", non_blocking=True)
        arrival = torch.get_device_module(device).current_stream().record_event()
        assert not torch.equal(copy, torch.arange(5.0))
        for _ in range(100):
            numbers = numbers + 1
        arrival.synchronize()
    assert torch.equal(copy, torch.arange(5.0))
    assert counts.waits == {}


def test_whoever_reads_at_once_waits(device: str) -> None:
    with counted() as counts:
        assert float(torch.ones((), device=device)) == 1
    assert sum(counts.waits.values()) == 1


def test_the_rasteriser_has_gsplats_signature() -> None:
    ours = [
        name for name in rasterization.PARAMETERS if name in inspect.signature(rasterization.rasterization).parameters
    ]
    assert ours == list(inspect.signature(rasterization.rasterization).parameters)
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed: its signature is as written down here")
    assert tuple(inspect.signature(gsplat.rasterization).parameters) == rasterization.PARAMETERS
