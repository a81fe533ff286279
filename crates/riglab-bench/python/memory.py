"""Forward and backward pass of the paper's TokenRig over a long sequence in bfloat16, with gradient checkpointing."""

import time

import torch
import torch.nn.functional as F
from torch.utils.checkpoint import checkpoint

from fsq_cvae import prepare
from serve import peak_memory_mb, serve
from tokenrig import TokenRig


def again(module):
    """The module, computed again in the backward pass."""
    forward = module.forward
    module.forward = lambda *args: checkpoint(forward, *args, use_reentrant=False)


def once(config, vocabulary, again_too, tokens, points):
    torch.set_default_dtype(torch.bfloat16)
    net = TokenRig(config, vocabulary)
    torch.set_default_dtype(torch.float32)
    if again_too:
        net.transformer.gradient_checkpointing_enable({"use_reentrant": False})
        shape = net.mesh_encoder.encoder
        for block in [shape.cross_attn, *shape.self_attn.resblocks]:
            again(block)
    net.train()
    with open("/proc/self/clear_refs", "w") as f:
        f.write("5")
    before, start = peak_memory_mb(), time.perf_counter()
    cloud = (torch.rand(1, points, 6) * 2 - 1).bfloat16()
    picks = torch.arange(config["shape"]["tokens"]).unsqueeze(0)
    ids = torch.randint(0, vocabulary, (1, tokens))
    scored = torch.ones(1, tokens - 1, dtype=torch.bool)
    logits = net({"cloud": cloud, "picks": picks, "ids": ids, "scored": scored})
    loss = F.cross_entropy(logits.float(), ids[0, 1:])
    value = loss.item()
    loss.backward()
    seconds = time.perf_counter() - start
    count = sum(p.numel() for p in net.parameters())
    return {"before": before, "most": peak_memory_mb(), "seconds": seconds, "loss": value, "parameters": count}


def run(config, again, threads, vocabulary, tokens, points):
    prepare(threads)
    return once(config, vocabulary, again, tokens, points)


if __name__ == "__main__":
    serve({"pass": run})
