"""A closed surface seen from behind: the two sides of a thin sheet have passed through one another.

No picture tells: either side takes the colours of the views that meet it. But shading and transport then see normals
that point into the sheet, so the sides are pushed apart again.
"""

from __future__ import annotations

import torch

from exmesh_graph.raster import Fragments
from exmesh_graph.stage1.vertices import any_turned, serves


def behind(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    projected: torch.Tensor,
    fragments: Fragments,
    intrinsics: torch.Tensor,
    shown: torch.Tensor | None = None,
) -> torch.Tensor | None:
    """Share of a view's pixels that show a face from behind, differentiable in the vertices; None where none does.

    vertices [V, 3], faces int32 [F, 3] of a closed surface, projected [V, 3] (`raster.project`), intrinsics [3, 3];
    shown uint8 [F], which faces the fragments have, where that is known: mostly none of them is seen from behind, which
    one pass over them tells.
    Every such pixel would be put right by some move of its face along the face's own normal, away from the camera,
    that no picture shows. The gradient takes this move to be the width of a pixel there: it is the share's if each
    pixel's say fell linearly to 0 over one width, so it compares with that of an outline against a unit contrast.
    """
    if shown is not None and serves(projected) and not any_turned(projected, faces, shown):
        return None
    faces = faces.long()
    face_id = fragments.face_id.view(-1)
    pixels = torch.bincount(face_id[face_id >= 0])
    seen = torch.nonzero(pixels)[:, 0]
    one, two, three = projected.detach()[faces[seen]].double().unbind(dim=1)
    # image rows go down: a front face, counter-clockwise in space, has a negative determinant
    turned = seen[(torch.linalg.cross(one, two) * three).sum(dim=1) > 0]
    if len(turned) == 0:
        return None
    count = pixels[turned].to(vertices.dtype) / len(face_id)
    own = vertices[faces[turned]]
    still = own.detach()
    normal = torch.linalg.cross(still[:, 1] - still[:, 0], still[:, 2] - still[:, 0])
    normal = normal / normal.norm(dim=1, keepdim=True).clamp(min=torch.finfo(normal.dtype).tiny)
    focal = (intrinsics[0, 0] * intrinsics[1, 1]).sqrt().to(vertices.dtype)
    width = projected.detach()[faces[turned], 2].mean(dim=1) / focal
    along = ((own - still).mean(dim=1) * normal).sum(dim=1) / width.clamp(min=torch.finfo(width.dtype).tiny)
    return (count * (1 - along)).sum()
