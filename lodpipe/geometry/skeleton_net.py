"""The graph of a skeleton while it is being worked on: pruned, merged, moved into the middle, bent inside."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.skeleton_rays import Rays
from lodpipe.geometry.skeleton_surface import Bool

SAMPLES_PER_UNIT = 250
"""Points looked at on a link as long as the model's diagonal."""
BEND_ROUNDS = 6
LONG, REFINE_ROUNDS, ZIP = 0.04, 5, 0.5
TANGENT_STEPS = 3
MOST_TRIMMED = 16
"""Branches of more nodes are not looked at: they stick out."""
BULGE, ELBOW = 0.2, 3.0
"""What sticks out of a ball by less than this share of its radius only rounds it off; what is as fat as the ball, as
the outside of an elbow is, must stick out by half of ELBOW, in between in proportion."""


@dataclass(eq=False)
class Net:
    """Nodes with a place, a height in their field and a component, and a set of neighbours each.

    A node that was merged is in `into`, and its domain with it; a node that was put onto a link has no domain.
    """

    place: list[F64] = field(default_factory=list)
    height: list[float] = field(default_factory=list)
    reach: list[float] = field(default_factory=list)
    """How much farther than its height the node's domain goes (both in lengths along the surface)."""
    radius: list[float] = field(default_factory=list)
    component: list[int] = field(default_factory=list)
    near: list[set[int]] = field(default_factory=list)
    into: list[int] = field(default_factory=list)
    kept: set[int] = field(default_factory=set)
    """Ends that are not taken in by what they hang on."""

    def add(self, place: F64, height: float, component: int, reach: float = 0.0, radius: float = 0.0) -> int:
        """A new node without links; its number."""
        self.place.append(place)
        self.height.append(height)
        self.reach.append(reach)
        self.radius.append(radius)
        self.component.append(component)
        self.near.append(set())
        self.into.append(len(self.into))
        return len(self.into) - 1

    def link(self, a: int, b: int) -> None:
        """Join two nodes."""
        self.near[a].add(b)
        self.near[b].add(a)

    def unlink(self, a: int, b: int) -> None:
        """Part two nodes."""
        self.near[a].discard(b)
        self.near[b].discard(a)

    @property
    def alive(self) -> list[int]:
        """Nodes that were not merged into others."""
        return [n for n, other in enumerate(self.into) if n == other]

    def links(self) -> list[tuple[int, int]]:
        """Each link once, lower number first, ascending."""
        return sorted((a, b) for a in self.alive for b in self.near[a] if a < b)

    def owners(self) -> I32:
        """For each node the one that it has become a part of."""
        into = np.array(self.into, np.int32)
        while True:
            further = into[into]
            if np.array_equal(further, into):
                return into
            into = further

    def merge(self, gone: int, stays: int) -> bool:
        """Put `gone`, a neighbour, into `stays`. False, and nothing is done, if a loop would be lost by it."""
        if self.near[gone] & self.near[stays]:
            return False
        self.unlink(gone, stays)
        for other in list(self.near[gone]):
            self.unlink(gone, other)
            self.link(stays, other)
        self.into[gone] = stays
        return True

    def path(self, start: int, step: int) -> list[int]:
        """From `start` over `step` as far as nodes have two links: ends with a joint, an end, or `start` again."""
        nodes = [start, step]
        while len(self.near[nodes[-1]]) == 2 and nodes[-1] != start:
            (after,) = self.near[nodes[-1]] - {nodes[-2]}
            nodes.append(after)
        return nodes

    def length(self, nodes: list[int]) -> float:
        """Length along the surface of a path."""
        return sum(abs(self.height[a] - self.height[b]) for a, b in itertools.pairwise(nodes))

    # ------------------------------------------------------------------ fewer nodes

    def prune(self, least: F64, straight: bool = False) -> None:
        """Take branches away that lead from a joint to an end and are shorter than `least` (C,), shortest first.

        Lengths are those along the surface, from the level at which a branch begins, or, with `straight`, those of
        the links, from the middle of the joint.
        """

        def branch(leaf: int) -> tuple[float, list[int]]:
            nodes = self.path(leaf, next(iter(self.near[leaf])))
            return (self.far(nodes) if straight else self.length(nodes)) + self.reach[leaf], nodes

        queue = [(branch(n)[0], n) for n in self.alive if len(self.near[n]) == 1]
        heapq.heapify(queue)
        while queue:
            known, leaf = heapq.heappop(queue)
            if self.into[leaf] != leaf or len(self.near[leaf]) != 1:
                continue
            length, nodes = branch(leaf)
            if length >= least[self.component[leaf]] or len(self.near[nodes[-1]]) < 3:
                continue
            if length > known:
                heapq.heappush(queue, (length, leaf))
                continue
            for gone, stays in itertools.pairwise(nodes):
                self.unlink(gone, stays)
                self.into[gone] = nodes[-1]

    def absorb(self) -> None:
        """Joints, and each component's fattest node, take in what hangs together with them and lies in their ball.

        The fattest first, as Wu et al. 2005 merge their domain balls.
        """
        hubs = {n for n in self.alive if len(self.near[n]) > 2} | self._fattest()
        for hub in sorted(hubs, key=lambda n: (-self.radius[n], n)):
            todo = sorted(self.near[hub]) if self.into[hub] == hub else []
            while todo:
                n = todo.pop()
                away = float(np.linalg.norm(self.place[n] - self.place[hub]))
                room = self.radius[hub] * (1 + BULGE if len(self.near[n]) == 1 else 1)
                if n not in self.near[hub] or n in self.kept or away >= room:
                    continue
                if self.merge(n, hub):
                    todo = sorted(self.near[hub])

    def trim(self, rays: Rays, points: F64, vertex: I32) -> None:
        """Take away branches that do not stick out: caps of level sets that only round off what they hang on.

        Where a branch hangs on a joint of three, the joint's place and ball are those that it has without the branch.
        """
        owner = self.owners()[vertex]
        order = np.argsort(owner, kind="stable")
        start = np.searchsorted(owner[order], np.arange(len(self.into) + 1))
        found: list[tuple[list[int], F64]] = []
        hubs = {n for n in self.alive if len(self.near[n]) > 2} | self._fattest()
        for leaf in self.alive:
            if len(self.near[leaf]) != 1 or leaf in hubs:
                continue
            path = [leaf, next(iter(self.near[leaf]))]
            while path[-1] not in hubs and len(self.near[path[-1]]) == 2:
                path += self.near[path[-1]] - {path[-2]}
            rows = np.concatenate([order[start[n] : start[n + 1]] for n in path[:-1]])
            tips = points[rows] if len(rows) else np.array([self.place[leaf]])
            if path[-1] in hubs and len(path) < MOST_TRIMMED:
                found.append((path, tips))
        if not found:
            return
        hub = [path[-1] for path, _ in found]
        tangents = np.zeros((len(found), 3))
        for row, (path, _) in enumerate(found):
            others = sorted(self.near[path[-1]] - {path[-2]})
            if len(others) == 2:
                a, b = (self.path(path[-1], n)[: TANGENT_STEPS + 1][-1] for n in others)
                tangents[row] = self.place[b] - self.place[a]
        component = np.array([self.component[n] for n in hub], np.int32)
        place = np.array([self.place[n] for n in hub])
        centres, radii = rays.centred(place, tangents, component, np.zeros(len(hub), bool))
        far = np.array([_farthest(t, c, d) for (_, t), c, d in zip(found, centres, tangents, strict=True)])
        # how fat the branch is: a third of the way from the ball to the tip
        tip = np.array([t[np.linalg.norm(t - c, axis=1).argmax()] for (_, t), c in zip(found, centres, strict=True)])
        away = tip - centres
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        at = centres + away * ((radii + np.maximum(distance - radii, 0) / 3) / distance)[:, None]
        _, fat = rays.centred(at, np.zeros_like(at), component, np.ones(len(at), bool))
        for row, ((path, _), centre, radius) in enumerate(zip(found, centres, radii, strict=True)):
            joint = path[-1]
            fatness = max(float(fat[row]), *(self.radius[n] for n in path[:-1])) / max(radius, 1e-12)
            bulge = 1 + max(BULGE, ELBOW * (fatness - 0.5))
            if far[row] > bulge * radius or not self.near[joint]:
                continue
            for gone, stays in itertools.pairwise(path):
                self.unlink(gone, stays)
                self.into[gone] = joint
            if len(self.near[joint]) == 2:
                self.place[joint], self.radius[joint] = centre, float(radius)

    def _fattest(self) -> set[int]:
        """The fattest node of each component."""
        fattest: dict[int, int] = {}
        for n in self.alive:
            c = self.component[n]
            if c not in fattest or self.radius[n] > self.radius[fattest[c]]:
                fattest[c] = n
        return set(fattest.values())

    def join_joints(self, least: F64) -> None:
        """Joints whose link is shorter than `least` (C,) become one, at the fatter one's place."""
        changed = True
        while changed:
            changed = False
            for joint in self.alive:
                if self.into[joint] != joint or len(self.near[joint]) < 3:
                    continue
                for step in sorted(self.near[joint]):
                    nodes = self.path(joint, step)
                    other = nodes[-1]
                    if other == joint or len(self.near[other]) < 3 or self.far(nodes) >= least[self.component[joint]]:
                        continue
                    stays = joint if (self.radius[joint], other) > (self.radius[other], joint) else other
                    line = nodes if stays == joint else nodes[::-1]
                    merged = [self.merge(n, stays) for n in line[1:] if n in self.near[stays]]
                    changed = all(merged) or changed
                    break

    def far(self, nodes: list[int]) -> float:
        """Length of the links of a path."""
        steps = itertools.pairwise(nodes)
        return float(sum(np.linalg.norm(self.place[a] - self.place[b]) for a, b in steps))

    # ------------------------------------------------------------------ better places

    def tangent(self, n: int) -> F64:
        """Direction of the skeleton at a node of two links, over a few nodes; zero at others."""
        if len(self.near[n]) != 2:
            return np.zeros(3)
        far = [self.path(n, step)[::TANGENT_STEPS][1:2] or self.path(n, step)[-1:] for step in sorted(self.near[n])]
        return self.place[far[1][0]] - self.place[far[0][0]]

    def centre(self, nodes: Iterable[int], rays: Rays, vertex: I32) -> None:
        """Move nodes into the middle of the surface, and find their radii. `vertex` (V,): each vertex's first node.

        An end stays in the middle of its domain, if that is inside.
        """
        chosen = list(nodes)
        if not chosen:
            return
        place = np.array([self.place[n] for n in chosen])
        component = np.array([self.component[n] for n in chosen], np.int32)
        tangent = np.array([self.tangent(n) for n in chosen])
        outside = np.flatnonzero(~rays.inside(place, component))
        if len(outside):
            wanted = [{chosen[i], *self.near[chosen[i]]} for i in outside]
            domain = self.owners()[vertex]
            place[outside] = rays.moved_in(place[outside], component[outside], wanted, domain)
        fixed = np.array([len(self.near[n]) == 1 for n in chosen])
        place, radius = rays.centred(place, tangent, component, fixed)
        for n, where, size in zip(chosen, place, radius, strict=True):
            self.place[n], self.radius[n] = where, float(size)

    def smooth(self, rounds: int = 2) -> None:
        """Move nodes of two links towards the middle of their neighbours, as far as the room round them allows."""
        for _ in range(rounds):
            moved = {}
            for n in self.alive:
                if len(self.near[n]) == 2:
                    a, b = self.near[n]
                    step = (self.place[a] + self.place[b]) / 4 - self.place[n] / 2
                    room = 0.25 * self.radius[n]
                    moved[n] = self.place[n] + step * min(1.0, room / max(float(np.linalg.norm(step)), 1e-12))
            for n, place in moved.items():
                self.place[n] = place

    def bend(self, rays: Rays, vertex: I32) -> None:
        """Give links that leave the surface a node where they do, moved inside.

        A node for which no place inside was found is left, and its links with it: so are those of flat components.
        """
        places = np.array([self.place[n] for n in self.alive]).reshape(-1, 3)
        component = np.array([self.component[n] for n in self.alive], np.int32)
        stuck = {n for n, ok in zip(self.alive, rays.inside(places, component), strict=True) if not ok}
        for _ in range(BEND_ROUNDS):
            new: list[int] = []
            for (a, b), t, inside in self._sampled(rays):
                if inside.all() or a in stuck or b in stuck:
                    continue
                middle = float(t[np.flatnonzero(~inside)[(~inside).sum() // 2]])
                place = self.place[a] + middle * (self.place[b] - self.place[a])
                height = self.height[a] + middle * (self.height[b] - self.height[a])
                n = self.add(place, height, self.component[a])
                self.unlink(a, b)
                self.link(a, n)
                self.link(n, b)
                new.append(n)
            if not new:
                return
            self.centre(new, rays, vertex)
            places = np.array([self.place[n] for n in new])
            ok = rays.inside(places, np.array([self.component[n] for n in new], np.int32))
            stuck |= {n for n, inner in zip(new, ok, strict=True) if not inner}

    def straighten(self, rays: Rays, vertex: I32, least: F64) -> None:
        """Lead links through the middle of the surface: long ones get nodes, those side by side become one."""
        self.centre([n for n in self.alive if len(self.near[n]) > 2], rays, vertex)
        self.refine(rays, vertex)
        self.join_joints(least)
        self.ease([n for n in self.alive if len(self.near[n]) == 2], rays, vertex, 2)
        self.bend(rays, vertex)

    def refine(self, rays: Rays, vertex: I32) -> None:
        """Give long links nodes in the middle of the surface."""
        new: list[int] = []
        for a, b in self.links():
            number = int(np.linalg.norm(self.place[a] - self.place[b]) / LONG)
            last = a
            if number:
                self.unlink(a, b)
            for k in range(number):
                t = (k + 1) / (number + 1)
                height = self.height[a] + t * (self.height[b] - self.height[a])
                n = self.add(self.place[a] + t * (self.place[b] - self.place[a]), height, self.component[a])
                self.link(last, n)
                new.append(n)
                last = n
            if number:
                self.link(last, b)
        self.ease(new, rays, vertex, REFINE_ROUNDS)
        self.zip()

    def ease(self, nodes: list[int], rays: Rays, vertex: I32, rounds: int) -> None:
        """Move nodes towards the middle in short steps, smoothed, so that neighbours go the same way."""
        for _ in range(rounds):
            before = {n: self.place[n] for n in nodes}
            self.centre(nodes, rays, vertex)
            for n in nodes:
                step = self.place[n] - before[n]
                far = float(np.linalg.norm(step))
                if far > LONG / 2:
                    self.place[n] = before[n] + step * (LONG / 2 / far)
            self.smooth(1)

    def zip(self) -> None:
        """Paths that leave a joint side by side become one, as far as they run together."""
        ends = {n for n in self.alive if len(self.near[n]) < 2}
        todo = [n for n in self.alive if len(self.near[n]) > 2]
        while todo:
            joint = todo.pop()
            near = sorted(self.near[joint], key=lambda n: (-self.radius[n], n))
            for a, b in itertools.combinations(near, 2):
                apart = float(np.linalg.norm(self.place[a] - self.place[b]))
                room = min(self.radius[a], self.radius[b])
                if apart >= ZIP * room or self.near[a] & self.near[b] != {joint} or b in self.near[a]:
                    continue
                if len(self.near[a]) == 1 or len(self.near[b]) == 1:
                    continue
                self.unlink(joint, b)
                for other in list(self.near[b]):
                    self.unlink(b, other)
                    self.link(a, other)
                self.into[b] = a
                self.place[a] = (self.place[a] + self.place[b]) / 2
                todo += [a, joint]
                break
        bare = [n for n in self.alive if len(self.near[n]) == 1 and n not in ends]
        while bare:  # joints all of whose paths have become one
            n = bare.pop()
            (stays,) = self.near[n]
            self.merge(n, stays)
            if len(self.near[stays]) == 1 and stays not in ends:
                bare.append(stays)

    def inside_shares(self, rays: Rays, count: int) -> list[float | None]:
        """For each of `count` components the share of the links' length that runs inside; None without length."""
        total, inner = np.zeros(count), np.zeros(count)
        for (a, b), _, inside in self._sampled(rays):
            length = float(np.linalg.norm(self.place[a] - self.place[b]))
            total[self.component[a]] += length
            inner[self.component[a]] += length * float(inside.mean())
        return [float(i / t) if t > 0 else None for i, t in zip(inner, total, strict=True)]

    def _sampled(self, rays: Rays) -> list[tuple[tuple[int, int], F64, Bool]]:
        """Each link with shares of its length, and whether the points there are inside."""
        links = self.links()
        if not links:
            return []
        shares, points, owner = [], [], []
        for a, b in links:
            step = self.place[b] - self.place[a]
            count = max(4, int(np.linalg.norm(step) * SAMPLES_PER_UNIT))
            t = (np.arange(count) + 0.5) / count
            shares.append(t)
            points.append(self.place[a] + t[:, None] * step)
            owner.append(np.full(count, self.component[a], np.int32))
        inside = rays.inside(np.concatenate(points), np.concatenate(owner))
        parts = np.split(inside, np.cumsum([len(t) for t in shares])[:-1])
        return list(zip(links, shares, parts, strict=True))


def _farthest(points: F64, centre: F64, tangent: F64) -> float:
    """The farthest that any of the points is from a line through `centre`, or from `centre` if `tangent` is zero."""
    away = points - centre
    length = float(np.linalg.norm(tangent))
    if length > 0:
        away = away - np.outer(away @ tangent, tangent) / length**2
    return float(np.sqrt(np.einsum("ij,ij->i", away, away).max()))
