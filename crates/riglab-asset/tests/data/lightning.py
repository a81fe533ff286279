"""Writes lightning.ckpt, a small checkpoint as Lightning leaves one: python lightning.py (torch 2.11).

Tensors of several types, some sharing a storage, some not in order, among objects of classes that no reader knows.
"""

import sys
import types
from collections import OrderedDict, defaultdict, deque
from pathlib import Path

import numpy as np
import torch

# A module that exists nowhere else.
foreign = types.ModuleType("foreign_settings")
sys.modules["foreign_settings"] = foreign


class Settings(dict):
    """A dictionary by another name, with attributes besides its keys."""

    __module__ = "foreign_settings"


class Opaque:
    """State that is set, and a constructor that is called."""

    __module__ = "foreign_settings"

    def __init__(self, *args):
        self.args = args
        self.loop = self

    def __reduce_ex__(self, protocol):
        return (Opaque, (1, "x", {2, 3}), {"big": 1 << 80, "small": -5}, iter([1, 2]), iter([("k", frozenset([9]))]))

    def __setstate__(self, state):
        self.__dict__.update(state)


foreign.Settings, foreign.Opaque = Settings, Opaque

base = torch.arange(24, dtype=torch.float32)
head = torch.nn.Parameter(torch.tensor([[0.5, -1.5]]))
state = OrderedDict(
    [
        ("model.whole.weight", base.view(4, 6)),
        ("model.shared.rows", base.view(4, 6)[1:3]),
        ("model.turned.weight", base.view(4, 6).t()),
        ("model.column", base.view(4, 6)[:, 2]),
        ("model.half", torch.tensor([1.5, -2.0], dtype=torch.float16)),
        ("model.brain", torch.tensor([1.5, -2.0], dtype=torch.bfloat16)),
        ("model.double", torch.tensor([0.1], dtype=torch.float64)),
        ("model.count", torch.tensor(7)),
        ("model.bytes", torch.tensor([250, 3], dtype=torch.uint8)),
        ("model.signed", torch.tensor([-3], dtype=torch.int8)),
        ("model.flag", torch.tensor([True, False])),
        ("model.empty", torch.zeros(0, 3)),
        ("model.parameter", head),
        ("model._extra_state", Opaque()),
    ]
)
state._metadata = OrderedDict([("", {"version": 1})])
settings = Settings(tokens_per_skin=4, model_config={"FSQ_dict": {"levels": [8, 8, 5]}})
settings.note = "an attribute"
checkpoint = {
    "epoch": 3,
    "global_step": 1400,
    "pytorch-lightning_version": "2.5.0",
    "state_dict": state,
    "optimizer_states": [{"state": {0: {"step": torch.tensor(2.0), "exp_avg": torch.ones(2)}}, "betas": (0.9, 0.999)}],
    "callbacks": {"best": np.float64(0.25), "seen": deque([1, 2]), "loss": defaultdict(list, {"a": [1]})},
    "hyper_parameters": settings,
    "random": np.random.RandomState(0).get_state(),
    "opaque": Opaque(),
}
torch.save(checkpoint, Path(__file__).with_name("lightning.ckpt"))
