"""Skeletons drawn by transformers' `generate`, under the strict grammar.

The grammar stands as it does after the tokens so far and takes one more at a step; what it allows is a
mask, kept where it comes again.
"""

import time

import torch
from transformers import LogitsProcessor, LogitsProcessorList

from fsq_cvae import prepare, read_tensors
from serve import serve
from unirig_skeleton import SkeletonModel

CHAIN, BRANCH = 3, 7


class Grammar:
    """One sequence's. `ids` names the tokens; `parts` has, by class, its parts in order: token and joints."""

    def __init__(self, ids, limits, masks):
        self.ids, self.limits, self.masks = ids, limits, masks
        self.state, self.tokens, self.joints, self.done = "class", 1, 0, False
        self.parts, self.lacking, self.free, self.owing, self.parted = [], 0, False, True, False
        # By the coordinates of a parent so far, those that may follow.
        self.cells, self.so_far = {(): set()}, ()

    def room(self, tokens):
        after = CHAIN * max(self.lacking - 1, 0) + 1
        return (self.joints + max(self.lacking, 1) <= self.limits["joints"]
                and self.tokens + tokens + after <= self.limits["tokens"])  # fmt: skip

    def room_for(self, joints, tokens=0):
        return (self.joints + joints <= self.limits["joints"]
                and self.tokens + tokens + CHAIN * joints + 2 <= self.limits["tokens"])  # fmt: skip

    def mask(self, coordinates, others):
        """A mask of all coordinates or none, and other tokens."""
        key = coordinates, others
        if key not in self.masks:
            mask = torch.zeros(self.ids["count"], dtype=torch.bool)
            mask[: self.ids["bins"]] = coordinates
            mask[list(others)] = True
            self.masks[key] = mask
        return self.masks[key]

    def allowed(self):
        ids = self.ids
        if self.done:
            return self.mask(False, (ids["pad"],))
        if self.state == "point":
            return self.mask(True, ())
        if self.state == "parent":
            mask = torch.zeros(ids["count"], dtype=torch.bool)
            mask[list(self.cells[self.so_far])] = True
            return mask
        if self.state == "class":
            fits = lambda parts: any(self.room_for(n, 1) for _, n in parts)
            return self.mask(False, (ids["none"], *(c for c, parts in ids["classes"].items() if fits(parts))))
        inside = self.lacking > 0
        others = []
        if (inside or self.free) and self.joints and self.room(BRANCH):
            others.append(ids["branch"])
        if not inside and (not self.owing or not self.joints and not self.parted):
            others += [part for part, n in self.parts if self.room_for(n)]
            if self.parted and (self.joints == 0 or not self.free) and self.room_for(1):
                others.append(ids["spring"])
        if not inside and not self.owing and self.joints:
            others.append(ids["eos"])
        return self.mask((inside or self.free) and self.room(CHAIN), tuple(others))

    def accept(self, id):
        ids = self.ids
        self.tokens += 1
        if self.state == "point" or self.state == "between" and id < ids["bins"]:
            self.state, self.so_far = "point", (*self.so_far, id)
            if len(self.so_far) == 3:
                self.end_joint()
        elif self.state == "parent":
            self.so_far = (*self.so_far, id)
            if len(self.so_far) == 3:
                self.state, self.so_far = "point", ()
        elif self.state == "class":
            self.parts = list(ids["classes"].get(id, ()))
            self.free, self.state = not self.parts, "between"
        elif id == ids["branch"]:
            self.state = "parent"
        elif id == ids["spring"]:
            self.free = self.owing = self.parted = True
            self.parts = []
        elif id == ids["eos"]:
            self.done = True
        else:
            at = next(k for k, (part, _) in enumerate(self.parts) if part == id)
            self.lacking = self.parts[at][1]
            del self.parts[: at + 1]
            self.free, self.owing, self.parted = False, True, True

    def end_joint(self):
        x, y, z = self.so_far
        self.cells[()].add(x)
        self.cells.setdefault((x,), set()).add(y)
        self.cells.setdefault((x, y), set()).add(z)
        if self.free:
            self.parts = []
        self.joints, self.lacking = self.joints + 1, max(self.lacking - 1, 0)
        self.state, self.so_far, self.owing = "between", (), False


class Strict(LogitsProcessor):
    """The grammars of a batch."""

    grammar = Grammar

    def __init__(self, ids, limits, rows, masks):
        self.grammars = [self.grammar(ids, limits, masks) for _ in range(rows)]

    def allowed(self, input_ids):
        """What may follow, [b, v], after one more token of each."""
        if input_ids.shape[1]:
            for grammar, id in zip(self.grammars, input_ids[:, -1].tolist()):
                if not grammar.done:
                    grammar.accept(id)
        return torch.stack([g.allowed() for g in self.grammars])

    def __call__(self, input_ids, scores):
        return scores.masked_fill(~self.allowed(input_ids), -torch.inf)


class Side:
    model, strict = SkeletonModel, Strict

    def open(self, file, config, threads, vocabulary):
        """Reads weights and prefixes; `vocabulary` names the tokens."""
        prepare(threads)
        tensors = read_tensors(file)
        self.ids = vocabulary
        self.ids["classes"] = {int(c): [tuple(part) for part in parts] for c, parts in vocabulary["classes"].items()}
        self.limits, self.masks = config["limits"], {}
        self.net = self.model(config["model"], vocabulary["count"]).eval()
        self.net.load({k[2:]: v for k, v in tensors.items() if k.startswith("w/")})
        self.prefix = tensors["prefix"]

    def attend(self, fused):
        """Takes the fused attention kernel, or its formula."""
        self.net.attend(fused)

    @torch.inference_mode()
    def draw(self, rows, generate, seed):
        """Sequences for the first rows, after the start, and the seconds that they took."""
        torch.manual_seed(seed)
        start = time.perf_counter()
        bos = self.net.transformer.get_input_embeddings()(torch.full((rows, 1), self.ids["bos"]))
        prompt = torch.cat([self.prefix[:rows], bos], 1)
        sampling = {k: generate[k] for k in ("temperature", "top_p")} | {"top_k": generate["top_k"]}
        out = self.net.transformer.generate(
            inputs_embeds=prompt,
            attention_mask=torch.ones(prompt.shape[:2], dtype=torch.long),
            logits_processor=LogitsProcessorList([self.strict(self.ids, self.limits, rows, self.masks)]),
            max_new_tokens=self.ids["longest"] - 1,
            do_sample=generate["sample"],
            repetition_penalty=generate["repetition_penalty"],
            eos_token_id=self.ids["end"],
            pad_token_id=self.ids["pad"],
            **(sampling if generate["sample"] else {}),
        )
        seconds = time.perf_counter() - start
        eos = self.ids["end"]
        return {"seconds": seconds, "ids": [r[: r.index(eos) + 1] if eos in r else r for r in out.tolist()]}


if __name__ == "__main__":
    side = Side()
    serve({name: getattr(side, name) for name in ("open", "attend", "draw")})
