"""Whole GRPO steps of TokenRig, as PyTorch's users write them: a group of rigs is drawn by transformers' `generate`
under the strict grammar, codes become weights, numpy and scipy give the rewards, and the policy takes a step.

The masks of the grammar that `generate` was given are kept for the likelihoods. Sequences are padded on the right;
being causal, the decoder needs no mask for that, which is faster than with one.

Shapes: b rigs of the group, p tokens of the shape, t tokens of the longest sequence with its start, v tokens in all.
"""

import copy
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from torch import nn
from transformers import LogitsProcessorList

import fsq_cvae
from fsq_cvae import prepare, read_tensors
from rewards import Scorer
from serve import serve
from skin_codes import Skinner, SkinCodes
from tokenrig import TokenRig
from tokenrig_generate import WholeStrict
from unirig_skeleton import Trainer

LEAST_SPREAD = 1e-4


class Recorded(WholeStrict):
    """Keeps what was allowed."""

    def __init__(self, *args):
        super().__init__(*args)
        self.seen = []

    def allowed(self, input_ids):
        self.seen.append(super().allowed(input_ids))
        return self.seen[-1]


def skeleton(tokens, ids):
    """Cells of the joints and their parents, and the rest of a sequence's tokens after its start."""
    cells, parents, parts, at, standing = [], [], [], 1, {}
    while tokens[at] != ids["eos"]:
        token, above = tokens[at], None
        if token >= ids["bins"] and token != ids["branch"]:
            parts += [token] if token != ids["spring"] else []
            at += 1
            continue
        if token == ids["branch"]:
            above = standing[tuple(tokens[at + 1 : at + 4])]
            at += 4
        own = tuple(tokens[at : at + 3])
        standing[own] = len(cells)
        cells.append(own)
        parents.append(above)
        at += 3
    # Joints written without a parent hang as the template has it, or on the one before.
    usual, places, start = list(range(-1, len(cells) - 1)), {}, 0
    for part in parts:
        first, own = ids["templates"][tokens[0], part]
        places.update((first + k, start + k) for k in range(len(own)))
        for k, above in enumerate(own):
            if places.get(above, start + k) < start + k:
                usual[start + k] = places[above]
        start += len(own)
    parents = [usual[k] if above is None else above for k, above in enumerate(parents)]
    return cells, parents, tokens[at + 1 :]


class Side:
    def open(self, file, config, settings, skin, vocabulary, lattice, turns, threads):
        """Reads weights and the mesh. `settings`: the policy's model; `skin`: the auto-encoder's."""
        prepare(threads)
        tensors = read_tensors(file)
        part = lambda name: {k[len(name) :]: v for k, v in tensors.items() if k.startswith(name)}
        self.config, self.settings, self.threads = config, settings, threads
        self.group, self.limits, self.masks = config["rollout"]["group"], settings["limits"], {}
        if config["rollout"]["temperature"] != 1.0 or config["objective"]["norm"] != "sequence":
            raise ValueError("the twin is written for a temperature of 1 and means over sequences")
        self.ids = vocabulary
        self.ids["classes"] = {int(c): [tuple(p) for p in parts] for c, parts in vocabulary["classes"].items()}
        self.ids["templates"] = {(c, p): (first, own) for c, p, first, own in vocabulary["templates"]}
        self.net = TokenRig(settings["model"], vocabulary["count"]).eval()
        self.trainer = Trainer(config, self.net, part("w/"), "fp32")
        self.start = copy.deepcopy(self.net).requires_grad_(False)
        self.skin = SkinCodes(skin).eval().requires_grad_(False)
        self.skin.load(part("v/"))
        self.mesh = part("mesh/")
        array = lambda name, kind: self.mesh[name].numpy().astype(kind)
        self.scorer = Scorer(array("vertices", np.float64), array("faces", np.int64), array("cells", np.int64),
                             np.array(lattice), np.array(turns), config["reward"])  # fmt: skip
        self.pool, self.fused = ThreadPoolExecutor(threads), dict.fromkeys(("draw", "decode", "learn"), True)
        self.steps, self.drawn, self.parts = 0, [], []

    def attend(self, part):
        """Takes the kind of attention that was found to be the faster one for a part of the step."""
        fsq_cvae.Attention.fused = self.fused[part]
        for net in (self.net, self.start):
            net.attend(self.fused[part])

    def faster(self):
        """Finds that out for each part."""
        ids, allowed = self.draw()
        rows = self.rows(ids)
        _, advantages = self.judge(self.weights(rows))
        learn = lambda: self.objective(ids, allowed, advantages, self.before(self.start, ids, allowed)).backward()
        work = {"draw": self.draw, "decode": lambda: self.weights(rows), "learn": learn}
        for part, run in work.items():
            seconds = {True: [], False: []}
            for _ in range(2):
                for fused, times in seconds.items():
                    self.fused[part] = fused
                    start = time.perf_counter()
                    run()
                    times.append(time.perf_counter() - start)
            self.fused[part] = min(seconds[True]) <= min(seconds[False])
        self.net.zero_grad()
        return self.fused

    def draw(self):
        """Ids [b, t - 1] after the start, and what was allowed for each, [b, t - 1, v]."""
        self.attend("draw")
        strict = Recorded(self.ids, self.limits, self.group, self.masks)
        with torch.inference_mode():
            prefix = self.net.condition(self.mesh["cloud"], self.mesh["picks"])
            start = self.net.transformer.get_input_embeddings()(torch.tensor([[self.ids["bos"]]]))
            prompt = torch.cat([prefix, start], 1).expand(self.group, -1, -1)
            ids = self.net.transformer.generate(
                inputs_embeds=prompt,
                attention_mask=torch.ones(prompt.shape[:2], dtype=torch.long),
                logits_processor=LogitsProcessorList([strict]),
                max_new_tokens=self.ids["longest"] - 1,
                do_sample=True,
                temperature=1.0,
                top_k=0,
                top_p=1.0,
                eos_token_id=self.ids["end"],
                pad_token_id=self.ids["pad"],
            )
        # Copies: gradients do not go through tensors of inference.
        return ids.clone(), torch.stack(strict.seen, 1).clone()

    def rows(self, ids):
        """The sequences, up to their ends."""
        return [row[: row.index(self.ids["end"]) + 1] for row in ids.tolist()]

    @torch.inference_mode()
    def weights(self, rows):
        """Heads, parents and raw weights [v, m] of each rig."""
        self.attend("decode")
        low, high = self.settings["tokenizer"]["range"]
        skinner = Skinner(self.skin, *(self.mesh[k] for k in ("skin_cloud", "skin_picks", "points", "vertices")))
        rigs = []
        for row in rows:
            cells, parents, rest = skeleton(row, self.ids)
            heads = (torch.tensor(cells) + 0.5) / self.settings["tokenizer"]["bins"] * (high - low) + low
            codes = torch.tensor(rest[:-1]).view(len(cells), -1) - self.ids["codes_from"]
            weights = skinner.raw(heads, torch.tensor(parents), codes)
            weights[weights < self.config["eval"]["cut"]] = 0
            rigs.append((heads.double().numpy(), np.array(parents), weights))
        return rigs

    def judge(self, rigs):
        """The rewards of rigs, and their advantages."""
        rewards = list(self.pool.map(lambda rig: self.scorer.score(*rig), rigs))
        total = torch.tensor(rewards, dtype=torch.float64) @ torch.tensor(self.config["reward"]["weights"]).double()
        return rewards, (total - total.mean()) / (total.std() + LEAST_SPREAD)

    def likely(self, net, ids, allowed):
        """Log-probabilities [b, t - 1] of the tokens that were free, else 0."""
        start = torch.full((len(ids), 1), self.ids["bos"])
        prefix = net.condition(self.mesh["cloud"], self.mesh["picks"])
        # What is scored stands after the start or another token: the last needs no reading.
        tokens = net.transformer.get_input_embeddings()(torch.cat([start, ids[:, :-1]], 1))
        read = torch.cat([prefix.expand(len(ids), -1, -1), tokens], 1)
        out = net.decoder()(inputs_embeds=read, use_cache=False).last_hidden_state[:, prefix.shape[1] :]
        free, table, first = allowed.sum(2) > 1, net.transformer.lm_head.weight, self.ids["codes_from"]
        of_skeleton, of_codes = free & (ids < first), free & (ids >= first)
        scores = (out[of_skeleton] @ table[:first].T).masked_fill(~allowed[of_skeleton][:, :first], -torch.inf)
        own = lambda scores, chosen: scores.log_softmax(1).gather(1, chosen.unsqueeze(1)).squeeze(1)
        log = torch.zeros(ids.shape).masked_scatter(of_skeleton, own(scores, ids[of_skeleton]))
        scores = out[of_codes] @ table[first : self.ids["end"]].T
        return log.masked_scatter(of_codes, own(scores, ids[of_codes] - first)), free

    @torch.no_grad()
    def before(self, net, ids, allowed):
        """What a policy that does not learn says of tokens."""
        self.attend("learn")
        return self.likely(net, ids, allowed)[0]

    def objective(self, ids, allowed, advantages, reference, old=None):
        """The rigs are gone over once: the policy that drew them is the one that learns, unless `old` says otherwise."""
        self.attend("learn")
        c = self.config["objective"]
        now, free = self.likely(self.net, ids, allowed)
        old = now.detach() if old is None else old
        ratio, advantage = (now - old).exp(), advantages.float().unsqueeze(1)
        high = c["clip_high"] or c["clip"]
        gain = torch.minimum(ratio * advantage, ratio.clamp(1 - c["clip"], 1 + high) * advantage)
        away = reference - now
        each = (gain - c["beta"] * (away.exp() - away - 1)) * free
        return -(each.sum(1) / free.sum(1)).mean()

    def check(self, rows, scale):
        """Of given sequences: rewards, log-probabilities of free tokens, the gradient's norm, and the loss once all
        weights are scaled."""
        longest = max(map(len, rows))
        ids = torch.tensor([row + [self.ids["pad"]] * (longest - len(row)) for row in rows])
        strict = Recorded(self.ids, self.limits, len(rows), self.masks)
        for t in range(longest):
            strict.allowed(ids[:, :t])
        allowed = torch.stack(strict.seen, 1)
        rewards, advantages = self.judge(self.weights(rows))
        old, reference = (self.before(net, ids, allowed) for net in (self.net, self.start))
        self.objective(ids, allowed, advantages, reference).backward()
        norm = nn.utils.clip_grad_norm_(self.net.parameters(), torch.inf).item()
        self.net.zero_grad()
        with torch.no_grad():
            own = [p.clone() for p in self.net.parameters()]
            torch._foreach_mul_(list(self.net.parameters()), scale)
            loss = self.objective(ids, allowed, advantages, reference, old).item()
            torch._foreach_copy_(list(self.net.parameters()), own)
        log = old[allowed.sum(2) > 1].tolist()
        return {"rewards": rewards, "log": log, "norm": norm, "loss": loss}

    def run(self, steps):
        """Seconds and losses of some more steps."""
        losses, start, cpu = [], time.perf_counter(), time.process_time()
        for _ in range(steps):
            losses.append(self.step())
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        return {"seconds": seconds, "cpu_seconds": cpu, "losses": losses}

    def step(self):
        torch.manual_seed(self.steps)
        self.steps += 1
        times = [time.perf_counter()]
        done = lambda: times.append(time.perf_counter())
        ids, allowed = self.draw()
        done()
        rows = self.rows(ids)
        rigs = self.weights(rows)
        done()
        _, advantages = self.judge(rigs)
        done()
        reference = self.before(self.start, ids, allowed)
        done()
        loss = self.trainer.update(self.objective(ids, allowed, advantages, reference))
        done()
        self.drawn += rows
        self.parts.append(np.diff(times).tolist())
        return loss

    def told(self):
        """All that was drawn, and the seconds of each step's drawing, decoding, rewards, likelihoods and update."""
        return {"ids": self.drawn, "parts": self.parts}


if __name__ == "__main__":
    side = Side()
    serve({name: getattr(side, name) for name in ("open", "faster", "check", "run", "told")})
