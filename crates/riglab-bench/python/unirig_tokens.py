"""Skeletons to tokens and back as UniRig's public code does it, written from its description.

Order of templates' parts first, coordinates rounded to cell edges, a branch names its parent by place; back
again, a joint's parent is the nearest one before it, and the ends of bones follow from the tree.
"""

import json
import time

import numpy as np

from serve import serve

STEP = np.float32(0.5)


class Tokenizer:
    def __init__(self, ids, templates):
        self.ids, self.templates = ids, templates
        self.part_of = {token: name for name, token in ids["parts"].items()}
        self.class_of = {token: name for name, token in ids["classes"].items()}

    def cells(self, points):
        bins = self.ids["bins"]
        return np.clip(np.round((points + np.float32(1)) / np.float32(2) * np.float32(bins)), 0, bins - 1).astype(int)

    def points(self, cells):
        return (np.asarray(cells, np.float32) + STEP) / np.float32(self.ids["bins"]) * np.float32(2) - np.float32(1)

    def order(self, names, parents, cls):
        """Places of joints, and parts by the place of their first joint."""
        place_of = {name: k for k, name in enumerate(names)}
        seen, new, parts = set(), [], {}
        for part, wanted in self.templates.get(cls, {}).items():
            if not all(name in place_of for name in wanted):
                continue
            own = [place_of[name] for name in wanted]
            seen.update(own)
            if any(parents[k] is not None and parents[k] not in seen for k in own):
                break
            parts[len(new)] = part
            new += own
        parts[len(new)] = None
        taken = set(new)
        return new + [k for k in range(len(names)) if k not in taken], parts

    def encode(self, joints, parents, names, cls):
        ids = self.ids
        order, parts = self.order(names, parents, cls)
        place = {k: at for at, k in enumerate(order)}
        cells = self.cells(joints[order]).tolist()
        out = [ids["bos"], ids["classes"].get(cls, ids["none"])]
        for at, k in enumerate(order):
            if at in parts:
                out.append(ids["spring"] if parts[at] is None else ids["parts"][parts[at]])
            parent = parents[k]
            if at > 0 and place[parent] != at - 1:
                out.append(ids["branch"])
                out += cells[place[parent]]
            out += cells[at]
        return out + [ids["eos"]]

    def decode(self, tokens):
        ids = self.ids
        if tokens[0] != ids["bos"] or tokens[-1] != ids["eos"]:
            raise ValueError("no start or end")
        heads, froms, parts, cls, branch, at = [], [], [], None, False, 1
        while at < len(tokens) - 1:
            token = tokens[at]
            if token < ids["bins"]:
                width = 6 if branch else 3
                found = tokens[at : at + width]
                heads.append(found[-3:])
                froms.append(found[:3] if branch or not heads[:-1] else heads[-2])
                branch = False
                at += width
                continue
            if token == ids["branch"]:
                branch = True
            elif token == ids["spring"]:
                parts.append(None)
            elif token in self.part_of:
                parts.append(self.part_of[token])
            elif token in self.class_of or token == ids["none"]:
                cls = self.class_of.get(token)
            else:
                raise ValueError(f"token {token}")
            at += 1
        joints, wanted = self.points(heads), self.points(froms)
        parents = [None]
        for k in range(1, len(joints)):
            # The nearest before it, the latest of equals.
            away = np.square(joints[:k] - wanted[k]).sum(1)
            parents.append(k - 1 - int(away[::-1].argmin()))
        names = [name for part in parts if part for name in self.templates.get(cls, {}).get(part, ())]
        names += [f"bone_{k}" for k in range(len(names), len(joints))]
        return joints, parents, self.tails(joints, parents), names, cls

    @staticmethod
    def tails(joints, parents):
        children = [[] for _ in parents]
        for k, parent in enumerate(parents[1:], 1):
            children[parent].append(k)
        from_parent = joints - joints[[0 if p is None else p for p in parents]]
        away = np.linalg.norm(from_parent, axis=1)
        tails = joints + STEP * from_parent
        tails[away <= 1e-9] = joints[away <= 1e-9] + np.float32([0, 0, 0.5])
        single = [k for k, c in enumerate(children) if len(c) == 1]
        tails[single] = joints[[children[k][0] for k in single]]
        if len(children[0]) > 1:
            mean = np.linalg.norm(joints[children[0]] - joints[0], axis=1).mean()
            tails[0] = joints[0] + STEP * (joints[0] + np.float32([0, 0, 0.5 * mean]))
        return tails


class Side:
    def open(self, file, ids, templates):
        """Reads skeletons; gives their sequences."""
        self.tokenizer = Tokenizer(ids, templates)
        with open(file) as f:
            read = json.load(f)
        array = lambda s: np.asarray(s["joints"], np.float32)
        self.skeletons = [(array(s), s["parents"], s["names"], s["class"]) for s in read]
        return [self.tokenizer.encode(*s) for s in self.skeletons]

    def run(self, times):
        """Seconds to encode and decode all, so many times, and the joints of all."""
        start, joints = time.perf_counter(), 0
        for _ in range(times):
            for s in self.skeletons:
                joints += len(self.tokenizer.decode(self.tokenizer.encode(*s))[0])
        return {"seconds": time.perf_counter() - start, "joints": joints}

    def parents(self):
        """What comes back."""
        return [self.tokenizer.decode(self.tokenizer.encode(*s))[1] for s in self.skeletons]


side = Side()
serve({name: getattr(side, name) for name in ("open", "run", "parents")})
