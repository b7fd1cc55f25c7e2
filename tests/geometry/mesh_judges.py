"""What is wrong with a mesh, by brute force."""

import numpy as np

from vttig_jax.geometry.mesh import GearMesh


def edges_are_paired(triangles: np.ndarray) -> bool:
    """Every edge is there once in each direction: closed and oriented."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    forward, times = np.unique(edges, axis=0, return_counts=True)
    return bool((times == 1).all()) and np.array_equal(forward, np.unique(edges[:, ::-1], axis=0))


def crossings(mesh: GearMesh) -> int:
    """Edges that pierce a triangle with which they share no point, by brute force."""
    corners = mesh.vertices[mesh.triangles]
    edges = np.unique(
        np.sort(np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])), axis=0
    )
    start, way = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    found = 0
    for triangle, (a, b, c) in zip(mesh.triangles, corners, strict=True):
        across = np.cross(way, c - a)
        volume = across @ (b - a)
        safe = np.where(np.abs(volume) > 1e-15, volume, np.nan)
        offset = start - a
        u = (offset * across).sum(axis=1) / safe
        turned = np.cross(offset, b - a)
        v = (way * turned).sum(axis=1) / safe
        t = (turned @ (c - a)) / safe
        tiny = 1e-9
        inside = (u > tiny) & (v > tiny) & (u + v < 1 - tiny) & (t > tiny) & (t < 1 - tiny)
        found += int((inside & ~np.isin(edges, triangle).any(axis=1)).sum())
    return found
