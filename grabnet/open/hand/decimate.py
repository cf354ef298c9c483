"""Fewer vertices by half-edge collapse: those that stay keep their place, so all per-vertex data stay valid."""

from __future__ import annotations

import heapq

import numpy as np


def decimate(
    vertices: np.ndarray, faces: np.ndarray, n_vertices: int, n_boundary: int, attributes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Collapse the cheapest edges of a mesh with one opening until few enough vertices are left.

    The cost is the quadric error (Garland & Heckbert 1997), raised where `attributes` (skin weights) change along the
    edge, so that joints keep their vertices. Collapses that fold, flip or thin out triangles are refused.

    Args:
        vertices (V, 3), faces (F, 3), attributes (V, A).
        n_vertices: vertices to keep.
        n_boundary: fewest of them on the boundary. Its own edges go first, so on a mesh with a longer boundary of
            even edges it comes down to about this many.

    Returns:
        ids (n_vertices,) of the kept vertices, ascending, and faces numbered by them.
    """
    mesh = _Collapsible(vertices, faces, attributes)
    mesh.shrink(n_vertices, n_boundary)
    kept = np.flatnonzero(mesh.alive)
    return kept, np.searchsorted(kept, np.array(list(mesh.faces.values())))


class _Collapsible:
    def __init__(self, vertices: np.ndarray, faces: np.ndarray, attributes: np.ndarray):
        self.vertices, self.attributes = vertices, attributes
        self.faces = dict(enumerate(map(tuple, faces.tolist())))
        self.around: list[set[int]] = [set() for _ in vertices]
        edges: dict[tuple[int, int], list[int]] = {}
        for i, face in self.faces.items():
            for a, b in zip(face, face[1:] + face[:1], strict=True):
                self.around[a].add(i)
                edges.setdefault((min(a, b), max(a, b)), []).append(i)
        self.edges = list(edges)
        self.rim = {edge: adjacent[0] for edge, adjacent in edges.items() if len(adjacent) == 1}
        self.alive = np.ones(len(vertices), bool)
        self.on_rim = np.zeros(len(vertices), bool)
        self.on_rim[[v for edge in self.rim for v in edge]] = True
        self.mean_edge = np.mean([np.linalg.norm(vertices[a] - vertices[b]) for a, b in edges])
        self.quadric = np.zeros((len(vertices), 4, 4))
        for face in self.faces.values():
            self._add_plane(face, self._normal(face) / 2)
        for (a, b), i in self.rim.items():  # planes upright on the rim hold its outline
            edge = vertices[b] - vertices[a]
            normal = self._normal(self.faces[i])
            upright = np.cross(edge, normal / np.linalg.norm(normal))
            self._add_plane((a, b), upright / np.linalg.norm(upright) * 10 * (edge @ edge))

    def shrink(self, n_vertices: int, n_boundary: int) -> None:
        version = np.zeros(len(self.vertices), int)
        heap: list[tuple[float, int, int, int, int]] = []

        def push(a: int, b: int) -> None:
            if not self.on_rim[a] or self.on_rim[b]:
                heapq.heappush(heap, (self._cost(a, b), a, b, version[a], version[b]))

        for a, b in self.edges:
            push(a, b)
            push(b, a)
        # The rim first, short edges first: the quadrics would spare it.
        rim = [(np.linalg.norm(self.vertices[a] - self.vertices[b]) - 1, a, b) for a, b in self.rim]
        for cost, a, b in rim:
            heapq.heappush(heap, (cost, a, b, 0, 0))
            heapq.heappush(heap, (cost, b, a, 0, 0))
        left, left_on_rim = len(self.vertices), len(self.rim)
        while left > n_vertices and heap:
            _, a, b, version_a, version_b = heapq.heappop(heap)
            if not (self.alive[a] and self.alive[b]) or version[a] != version_a or version[b] != version_b:
                continue
            shared = [i for i in self.around[a] if b in self.faces[i]]
            if not shared or (self.on_rim[a] and (len(shared) != 1 or left_on_rim <= n_boundary)):
                continue
            if not self._keeps_shape(a, b, shared):
                continue
            self._collapse(a, b, shared)
            left -= 1
            left_on_rim -= int(self.on_rim[a])
            version[b] += 1
            for c in self._neighbours(b):
                push(b, c)
                push(c, b)

    def _normal(self, face: tuple[int, ...]) -> np.ndarray:
        a, b, c = self.vertices[list(face)]
        return np.cross(b - a, c - a)

    def _add_plane(self, corners: tuple[int, ...], weighted_normal: np.ndarray) -> None:
        weight = np.linalg.norm(weighted_normal) + 1e-18
        normal = weighted_normal / weight
        plane = np.append(normal, -normal @ self.vertices[corners[0]])
        for corner in corners:
            self.quadric[corner] += weight * np.outer(plane, plane)

    def _neighbours(self, a: int) -> set[int]:
        return {v for i in self.around[a] for v in self.faces[i]} - {a}

    def _cost(self, a: int, b: int) -> float:
        point = np.append(self.vertices[b], 1)
        error = point @ (self.quadric[a] + self.quadric[b]) @ point
        short = 0.03 * self.mean_edge**2 * np.sum((self.vertices[a] - self.vertices[b]) ** 2)  # even triangles on flats
        return float((error + short) * (1 + 5 * np.abs(self.attributes[a] - self.attributes[b]).sum()))

    def _keeps_shape(self, a: int, b: int, shared: list[int]) -> bool:
        if len(self._neighbours(a) & self._neighbours(b)) != len(shared):
            return False  # the result would no longer be a manifold
        for i in self.around[a].difference(shared):
            before = self._normal(self.faces[i])
            moved = tuple(b if v == a else v for v in self.faces[i])
            after = self._normal(moved)
            area = np.linalg.norm(after)
            if before @ after < 0.3 * np.linalg.norm(before) * area:
                return False
            corners = self.vertices[list(moved)]
            longest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()
            if area < 0.15 * longest**2:
                return False
        return True

    def _collapse(self, a: int, b: int, shared: list[int]) -> None:
        for i in shared:
            for v in self.faces.pop(i):
                self.around[v].discard(i)
        for i in self.around[a]:
            self.faces[i] = tuple(b if v == a else v for v in self.faces[i])
            self.around[b].add(i)
        self.around[a] = set()
        self.alive[a] = False
        self.quadric[b] += self.quadric[a]
