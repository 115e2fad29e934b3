"""The check of a device: it passes where results are the same, and names the operation where they are not."""

import json
import warnings

import pytest
import torch

from exmesh_graph import device_check
from exmesh_graph.api import doctor
from exmesh_graph.errors import ExmeshError
from exmesh_graph.gpu import torch_setup, verdict
from exmesh_graph.gpu.settings import DeviceSettings


def test_every_operation_agrees_with_itself_and_shows_something():
    for name, trial in device_check.TRIALS.items():
        results = trial(torch.device("cpu"))
        assert all(bool(value.double().abs().sum() > 0) for value in results.values()), name
        assert device_check.difference(results, trial(torch.device("cpu"))) == "", name


def test_faces_are_seen_and_missed():
    face_id = device_check._visibility(torch.device("cpu"))["face_id"]
    assert 0.05 < float((face_id >= 0).float().mean()) < 0.95


def failing(change):
    """An operation that gives something else when it runs for the second time, as on another device."""
    runs = []

    def trial(device):
        runs.append(device)
        results = {"value": torch.linspace(0, 1, 50), "gradient of x": torch.ones(50), "face": torch.arange(50)}
        return results if len(runs) == 1 else change(results)

    return trial


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda r: r, ""),
        (lambda r: r | {"value": r["value"] * 1.01}, "value is off by 0.01"),
        (lambda r: r | {"gradient of x": -r["gradient of x"]}, "gradient of x is off by 2"),
        (lambda r: r | {"value": r["value"] / 0}, "value is not finite"),
        (lambda r: r | {"value": r["value"][:3]}, "value has the shape (3,)"),
        (lambda r: r | {"face": r["face"] + 1}, "face: 0.0%"),
        (lambda r: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_a_failing_operation_is_named(change, fault):
    good, bad = device_check.check("cpu", {"good": failing(lambda r: r), "bad": failing(change)})
    assert good.fault == ""
    assert bad.operation == "bad"
    assert bad.fault.startswith(fault) if fault else bad.fault == ""


@pytest.fixture
def gpu(monkeypatch, tmp_path):
    """A machine on which torch sees a CUDA device, and a check whose outcomes a test sets."""
    outcomes = [{"operation": "rays", "fault": "", "seconds": 0.1}]
    runs = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a device")
    monkeypatch.setattr(verdict, "run_check", lambda device: runs.append(device) or outcomes)
    verdict.cuda_fault.cache_clear()
    yield outcomes, runs
    verdict.cuda_fault.cache_clear()


def test_auto_takes_a_gpu_that_has_passed_and_checks_it_once(gpu):
    _, runs = gpu
    for _ in range(2):
        assert torch_setup.pick_device("auto").type == "cuda"
        verdict.cuda_fault.cache_clear()  # as in another process
    assert runs == ["cuda"]
    assert torch_setup.pick_device("cpu").type == "cpu"


def test_auto_leaves_a_gpu_that_has_failed_and_says_so_once(gpu):
    outcomes, _ = gpu
    outcomes[0]["fault"] = "distance is off by 0.3 of its mean size"
    with pytest.warns(UserWarning, match=r"not used: rays: distance is off.*doctor --gpu.*device: cuda"):
        assert torch_setup.pick_device("auto").type == "cpu"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch_setup.pick_device("auto").type == "cpu"
    assert torch_setup.pick_device("cuda").type == "cuda"


def test_another_driver_or_version_is_checked_anew(gpu, monkeypatch):
    _, runs = gpu
    torch_setup.pick_device("auto")
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "another device")
    verdict.cuda_fault.cache_clear()
    torch_setup.pick_device("auto")
    assert runs == ["cuda", "cuda"]


def test_a_broken_file_of_outcomes_is_no_obstacle(gpu, tmp_path):
    (tmp_path / "exmesh-graph").mkdir()
    (tmp_path / "exmesh-graph" / "gpu.json").write_text("{", encoding="utf-8")
    assert torch_setup.pick_device("auto").type == "cuda"
    assert json.loads((tmp_path / "exmesh-graph" / "gpu.json").read_text(encoding="utf-8"))


def test_the_doctor_tells_each_operation(gpu, monkeypatch):
    outcomes, _ = gpu
    outcomes.append({"operation": "Gaussians", "fault": "value is not finite", "seconds": 2.0})
    monkeypatch.setattr(doctor, "_gpu", lambda: doctor.Finding(doctor.OK, "GPU", "1 x a device"))
    lines = [str(finding) for finding in doctor.examine_gpu()]
    assert lines[1].startswith("ok    rays: as on the CPU")
    assert lines[2].startswith("warn  Gaussians: value is not finite")
    assert "takes the CPU" in lines[3]


def test_memory_that_does_not_suffice_is_told_with_the_parameters_that_help():
    settings = DeviceSettings(device="cpu")
    told = pytest.raises(ExmeshError, match=r"(?s)memory does not suffice \(tried to allocate 9 GiB\).*downscale")
    with told, torch_setup.computing(settings):
        raise torch.OutOfMemoryError("tried to allocate 9 GiB\nof 8")


@pytest.mark.thorough
def test_a_check_that_dies_is_a_fault(monkeypatch):
    """A device that does not exist here stands for a driver that ends the process."""
    outcomes = verdict.run_check("no-such-device")
    assert all(outcome["fault"] for outcome in outcomes)
    monkeypatch.setattr(verdict.sys, "executable", "/bin/false")
    (outcome,) = verdict.run_check("cuda")
    assert "broke off with 1" in outcome["fault"]
