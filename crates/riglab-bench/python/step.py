"""Training steps of the twin on batches and weights given in a file."""

import os
import time

import torch
from torch.utils.flop_counter import FlopCounterMode

import fsq_cvae
from fsq_cvae import Attention, Trainer
from serve import peak_memory_mb, serve


class Side:
    def open(self, file, config, precision, threads, fused, compile):
        """Reads weights and batches; gives the loss of each batch.

        `compile` names a folder for what torch.compile makes, fresh so that no older cache decides.
        """
        fsq_cvae.prepare(threads)
        tensors = fsq_cvae.read_tensors(file)
        weights = {k[2:]: v for k, v in tensors.items() if k.startswith("w/")}
        self.batches = []
        while f"{len(self.batches)}/prefix" in tensors:
            start = f"{len(self.batches)}/"
            batch = {k[len(start) :]: v for k, v in tensors.items() if k.startswith(start)}
            prefix = int(batch.pop("prefix"))
            self.batches.append((batch, prefix))
        self.trainer = Trainer(config, weights, precision)
        Attention.fused = fused
        with torch.no_grad():
            losses = [self.trainer.loss(*b).item() for b in self.batches]
        if compile:
            os.environ["TORCHINDUCTOR_CACHE_DIR"] = compile
            # A graph for each prefix length: faster than one with a dynamic length, once compiled.
            self.trainer.forward = torch.compile(self.trainer.net, dynamic=False)
        return losses

    def fused_is_faster(self):
        """Whether the fused attention kernel beats its formula here."""
        seconds = {True: [], False: []}
        for _ in range(6):
            for Attention.fused, times in seconds.items():
                start = time.perf_counter()
                for batch in self.batches:
                    self.trainer.loss(*batch).backward()
                times.append(time.perf_counter() - start)
        return min(seconds[True]) <= min(seconds[False])

    def run(self, steps):
        """Seconds and losses of some more steps."""
        losses, start, cpu = [], time.perf_counter(), time.process_time()
        for _ in range(steps):
            losses.append(self.trainer.step(*self.batches[self.trainer.steps % len(self.batches)]))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        return {"seconds": seconds, "cpu_seconds": cpu, "losses": losses}

    def flops(self):
        """Floating point operations of matrix products in a step, mean over the batches."""
        Attention.fused = False  # the counter does not know the fused kernel of processors
        with FlopCounterMode(display=False) as counter:
            self.run(len(self.batches))
        return counter.get_total_flops() / len(self.batches)

    def memory(self):
        return peak_memory_mb()


side = Side()
serve({name: getattr(side, name) for name in ("open", "fused_is_faster", "run", "flops", "memory")})
