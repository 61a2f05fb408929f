"""One step of the automaton in plain loops over plain integers, written from the specification, not from the code.

Sites are tuples, cells a set; no windows, no flat indices, no shared helper except the random generator.
"""

from itertools import product

import numpy as np

from cicatrix.core.philox import philox4x32

EDGE, MOTILITY, LAYER, PATH, LEVEL_SET, SETTLE = range(6)
NEIGHBOURS = {
    2: [(1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1)],
    3: [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)],
}
NEIGHBOURS[3] += [(1, -1, 0), (1, 0, -1), (-1, 1, 0), (0, 1, -1), (-1, 0, 1), (0, -1, 1)]


class SlowStep:
    def __init__(self, fillable, rules, seed, step, w=0.0, w_ref=1.0):
        self.shape, self.ndim = fillable.shape, fillable.ndim
        self.sites = {s for s in product(*map(range, self.shape)) if fillable[s]}
        self.rules, self.seed, self.step = rules, seed, step
        self.w, self.w_ref = w, w_ref

    def word(self, site, phase, i=None):
        """Return word i of the site's own call; without i, the site's word of the call that four sites share."""
        number = 0
        for x, n in zip(site, self.shape):
            number = number * n + x
        if i is None:
            number, i = divmod(number, 4)
        counter = [number % 2**32, number // 2**32, self.step, phase]
        key = [self.seed % 2**32, self.seed // 2**32]
        return int(philox4x32(np.array(counter, np.uint32), np.array(key, np.uint32))[i])

    def number(self, site):
        return int(np.ravel_multi_index(site, self.shape))

    def around(self, site):
        all_of_them = [tuple(a + b for a, b in zip(site, off)) for off in NEIGHBOURS[self.ndim]]
        return [s for s in all_of_them if s in self.sites]

    def edge(self, cells):
        new = set()
        for s in cells:
            free = [q for q in self.around(s) if q not in cells]
            if len(free) >= self.rules.min_free_neighbours and self.word(s, EDGE, 0) < int(self.rules.p_edge * 2**32):
                new.add(free[self.word(s, EDGE, 1) * len(free) // 2**32])
        return cells | new

    def diffuse(self, cells):
        own, shift, bulk = {2: (2, 3, 8191), 3: (4, 4, 4095)}[self.ndim]
        n_neighbours = len(NEIGHBOURS[self.ndim])
        u = {s: bulk if s in cells else 0 for s in self.sites}
        for _ in range(self.rules.motility_substeps):
            new = {}
            for s in self.sites:
                near = self.around(s)
                total = own * u[s] + sum(u[q] for q in near) + (n_neighbours - len(near)) * u[s]
                new[s] = (total + (1 << shift) // 2) >> shift
            u = new
        return u

    def largest(self, u, sites, count, phase):
        return set(sorted(sites, key=lambda s: (-u[s], self.word(s, phase), self.number(s)))[:count])

    def motility(self, cells):
        if self.rules.motility_substeps == 0:
            return cells
        return self.largest(self.diffuse(cells), self.sites, len(cells), MOTILITY)

    def hops(self, a, b):
        d = [x - y for x, y in zip(a, b)]
        return max(sum(x for x in d if x > 0), sum(-x for x in d if x < 0))

    def layer(self, cells, reach):
        free = self.sites - cells
        return {s for s in cells if any(self.hops(s, q) <= reach for q in free)}

    def divide(self, layer):
        parents = []
        for s in layer:
            w = self.w[s] if np.ndim(self.w) else self.w
            p = self.rules.p_layer * (1 + self.rules.feedback * w / self.w_ref)
            if self.word(s, LAYER) < int(min(max(p, 0.0), 1.0) * 2**32):
                parents.append(s)
        return parents

    def cost(self, s):
        return 64 + self.word(s, PATH) * (int(64 * self.rules.path_noise) + 1) // 2**32

    def settle(self, s, cells):
        unit = 48 // len(NEIGHBOURS[self.ndim])
        n_free = sum(q not in cells for q in self.around(s))
        return unit * n_free + self.word(s, SETTLE) * unit // 2**32

    def distance(self, paths, cells):
        far = 65535
        d = dict.fromkeys(self.sites, far) | {s: self.settle(s, cells) for s in self.sites - cells}
        while True:
            new = {s: min([d[q] for q in self.around(s)], default=far) + self.cost(s) for s in paths}
            new = {s: min(v, far) for s, v in new.items()}
            if all(d[s] == v for s, v in new.items()):
                return d, far
            d.update(new)

    def route(self, cells, layer, parents):
        cells, paths, tokens = set(cells), set(layer), list(parents)
        while tokens:
            d, far = self.distance(paths, cells)
            at = []
            for s in tokens:
                if d[s] >= far:
                    continue
                while s in cells:
                    s = min(self.around(s), key=lambda q: d[q])  # the first of equals, in the order of NEIGHBOURS
                at.append(s)
            tokens = list(at)
            for s in set(at):
                tokens.remove(s)
            cells |= set(at)
            paths |= set(at)
        return cells

    def level_set(self, cells, parents):
        reach = max(self.rules.layer_sites, self.rules.motility_substeps)
        zone = self.layer(cells, reach) | (self.sites - cells)
        u, result = self.diffuse(cells), set(cells)
        while zone:
            component, todo = set(), [next(iter(zone))]
            while todo:
                s = todo.pop()
                if s in zone:
                    zone.discard(s)
                    component.add(s)
                    todo += self.around(s)
            n_new = sum(s in component for s in parents)
            if n_new:
                count = len(component & cells) + n_new
                result = (result - component) | self.largest(u, component, count, LEVEL_SET)
        return result

    def run(self, occupancy):
        cells = {s for s in self.sites if occupancy[s]}
        if cells != self.sites:
            cells = self.motility(self.edge(cells))
            layer = self.layer(cells, self.rules.layer_sites)
            parents = self.divide(layer)
            is_route = self.rules.redistribution == "route"
            cells = self.route(cells, layer, parents) if is_route else self.level_set(cells, parents)
        after = np.zeros(self.shape, bool)
        for s in cells:
            after[s] = True
        return after
