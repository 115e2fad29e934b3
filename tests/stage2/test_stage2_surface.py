"""Surface samples by one kernel against torch in float64: random points, grazing views, flipped and bad faces."""

import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.stage2.surface import CarrierGeometry


def _points(count, faces, seed=0):
    generator = torch.Generator().manual_seed(seed)
    face = torch.randint(faces, (count,), generator=generator)
    bary = torch.rand(count, 3, generator=generator)
    return face, bary / bary.sum(1, keepdim=True)


def _wide(geometry):
    wide = CarrierGeometry.__new__(CarrierGeometry)
    for name, value in vars(geometry).items():
        is_float = isinstance(value, torch.Tensor) and value.is_floating_point()
        setattr(wide, name, value.double() if is_float else value)
    return wide


@pytest.mark.parametrize("count", [0, 1, 5000])
@pytest.mark.parametrize("eye", [[0.3, 1.5, 2.0], [0.0, -0.44, 3.0], [0.0, 0.1, 0.0]])  # beside, along the slab, inside
def test_samples_agree_with_plain_ones(carrier, count, eye):
    faces = carrier.faces.copy()
    faces[::3] = faces[::3, ::-1]  # wound the other way
    geometry = CarrierGeometry(dataclasses.replace(carrier, faces=faces))
    face, bary = _points(count, len(faces))
    found = geometry.samples(face, bary, torch.tensor(eye))
    expected = _wide(geometry).samples(face, bary.double(), torch.tensor(eye).double())
    # a face seen along its own plane may be taken for its back
    along = (expected.flat * expected.view).sum(1).abs() < 1e-5
    for name in ("position", "normal", "flat", "view", "reflected", "n_v", "uv"):
        ours, exact = getattr(found, name).double(), getattr(expected, name)
        torch.testing.assert_close(ours[~along], exact[~along], rtol=1e-5, atol=2e-5)
    assert torch.equal(found.face, face)
    assert torch.equal(found.bary, bary)


def test_a_face_without_area_and_a_camera_on_the_surface_stay_finite(carrier):
    vertices = carrier.vertices.copy()
    vertices[carrier.faces[0]] = vertices[carrier.faces[0][0]]
    geometry = CarrierGeometry(dataclasses.replace(carrier, vertices=vertices))
    face, bary = torch.tensor([0, 0, 5]), torch.tensor([[1.0, 0, 0], [0.2, 0.3, 0.5], [1.0, 0, 0]])
    eye = torch.from_numpy(np.asarray(vertices[carrier.faces[5][0]]))
    found, plain = geometry.samples(face, bary, eye), geometry.plain_samples(face, bary, eye)
    for name, values in vars(found).items():
        assert torch.isfinite(values).all(), name
        torch.testing.assert_close(values, getattr(plain, name), rtol=1e-5, atol=1e-5)


def test_the_same_bytes_for_any_number_of_cores(carrier):
    geometry, found = CarrierGeometry(carrier), []
    for count in (1, 2, 3):
        with cores(count):
            samples = geometry.samples(*_points(9000, len(carrier.faces)), torch.tensor([0.3, 1.5, 2.0]))
            found.append(torch.cat([value.reshape(-1) for value in vars(samples).values()]))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


@pytest.mark.filterwarnings("error")
def test_arrays_of_an_artifact_are_read_without_a_warning(carrier):
    """What lies on a wire may not be written; torch warns of such arrays, and the node's log would show it."""
    arrays = {name: getattr(carrier, name).copy() for name in ("vertices", "faces", "uvs", "uv_faces")}
    for array in arrays.values():
        array.flags.writeable = False
    kept = CarrierGeometry(dataclasses.replace(carrier, **arrays))
    assert np.array_equal(kept.vertices.numpy(), arrays["vertices"])
