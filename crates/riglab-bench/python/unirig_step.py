"""Training steps of the twins of the skeleton model and of TokenRig on batches and weights given in a file."""

import time

import torch

from fsq_cvae import prepare, read_tensors
from serve import peak_memory_mb, serve
from tokenrig import TokenRig
from unirig_skeleton import SkeletonModel, Trainer, padded

MODELS = {"unirig_skeleton": SkeletonModel, "tokenrig": TokenRig}


class Side:
    def open(self, model, file, config, precision, threads, fused, vocabulary):
        """Reads weights and batches; gives the loss of each batch, nothing dropped."""
        prepare(threads)
        tensors = read_tensors(file)
        weights = {k[2:]: v for k, v in tensors.items() if k.startswith("w/")}
        self.batches, names = [], ("ids", "lengths", "cloud", "picks")
        while f"{len(self.batches)}/ids" in tensors:
            self.batches.append(padded(*(tensors[f"{len(self.batches)}/{name}"] for name in names)))
        self.trainer = Trainer(config, MODELS[model](config["model"], vocabulary), weights, precision)
        return self.first(fused)

    def first(self, fused):
        """The loss of each batch, nothing dropped."""
        self.trainer.net.attend(fused)
        self.trainer.net.eval()
        with torch.no_grad():
            losses = [self.trainer.loss(b).item() for b in self.batches]
        self.trainer.net.train()
        return losses

    def fused_is_faster(self):
        """Whether the fused attention kernel beats its formula here."""
        seconds = {True: [], False: []}
        for _ in range(4):
            for fused, times in seconds.items():
                self.trainer.net.attend(fused)
                start = time.perf_counter()
                for batch in self.batches:
                    self.trainer.loss(batch).backward()
                times.append(time.perf_counter() - start)
        return min(seconds[True]) <= min(seconds[False])

    def run(self, steps):
        """Seconds and losses of some more steps."""
        losses, start, cpu = [], time.perf_counter(), time.process_time()
        for _ in range(steps):
            losses.append(self.trainer.step(self.batches[self.trainer.steps % len(self.batches)]))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        return {"seconds": seconds, "cpu_seconds": cpu, "losses": losses}

    def memory(self):
        return peak_memory_mb()


if __name__ == "__main__":
    side = Side()
    serve({name: getattr(side, name) for name in ("open", "fused_is_faster", "run", "memory")})
