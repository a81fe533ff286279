"""UniRig's skeleton model and its training step, as PyTorch's users write them.

The decoder is OPT as transformers has it; the shape encoder is written from its definition in
`crates/riglab-nn`, with the same names of parameters. Sequences of a batch are padded on the right to
the longest, as the public code does.

Shapes: b rigs, n points, p tokens of the shape, t tokens of the longest sequence.
"""

import re

import torch
import torch.nn.functional as F
from torch import nn
from transformers import OPTConfig, OPTForCausalLM

from fsq_cvae import Muon, factor, picked

PAD = -100


class Attention(nn.Module):
    """Query, key and value in one matrix, head by head; or query apart from key and value."""

    # Fused scaled_dot_product_attention, or its formula.
    fused = True

    def __init__(self, width, heads, bias, others):
        super().__init__()
        self.heads, self.others = heads, others
        if others:
            self.c_q, self.c_kv = nn.Linear(width, width, bias), nn.Linear(width, 2 * width, bias)
        else:
            self.c_qkv = nn.Linear(width, 3 * width, bias)
        self.c_proj = nn.Linear(width, width)

    def parts(self, x, n):
        b, t, d = x.shape
        return x.view(b, t, self.heads, n, d // n // self.heads).permute(3, 0, 2, 1, 4).unbind(0)

    def forward(self, x, others=None):
        if self.others:
            (q,), (k, v) = self.parts(self.c_q(x), 1), self.parts(self.c_kv(others), 2)
        else:
            q, k, v = self.parts(self.c_qkv(x), 3)
        if Attention.fused:
            read = F.scaled_dot_product_attention(q, k, v)
        else:
            read = (q * q.shape[-1] ** -0.5 @ k.transpose(-2, -1)).softmax(-1) @ v
        return self.c_proj(read.transpose(1, 2).reshape(x.shape))


class Block(nn.Module):
    def __init__(self, width, heads, bias, others):
        super().__init__()
        self.attn = Attention(width, heads, bias, others)
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        if others:
            self.ln_3 = nn.LayerNorm(width)
        self.mlp = nn.Module()
        self.mlp.c_fc, self.mlp.c_proj = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)
        self.others = others

    def forward(self, x, others=None):
        if self.others:
            x = x + self.attn(self.ln_1(x), self.ln_2(others))
            own = self.ln_3(x)
        else:
            x = x + self.attn(self.ln_1(x))
            own = self.ln_2(x)
        return x + self.mlp.c_proj(F.gelu(self.mlp.c_fc(own)))


class Perceiver(nn.Module):
    def __init__(self, c):
        super().__init__()
        frequencies = torch.tensor([2.0**k for k in range(c["frequencies"])])
        self.register_buffer("frequencies", frequencies, persistent=False)
        block = (c["width"], c["heads"], c["qkv_bias"])
        self.input_proj = nn.Linear(6 + 6 * c["frequencies"], c["width"])
        self.cross_attn = Block(*block, others=True)
        self.self_attn = nn.Module()
        self.self_attn.resblocks = nn.ModuleList(Block(*block, others=False) for _ in range(c["layers"]))
        self.ln_post = nn.LayerNorm(c["width"])

    def forward(self, cloud, picks):
        x, normals = cloud.split(3, -1)
        angle = (x.unsqueeze(-1) * self.frequencies).flatten(-2)
        data = self.input_proj(torch.cat([x, angle.sin(), angle.cos(), normals], -1))
        x = self.cross_attn(picked(data, picks), data)
        for block in self.self_attn.resblocks:
            x = block(x)
        return self.ln_post(x)


class PrefixModel(nn.Module):
    """A decoder behind the tokens of a shape; transformers has the decoder, as `self.transformer`."""

    def load(self, weights):
        missing, unknown = self.load_state_dict(weights, strict=False)
        if unknown or missing not in ([], ["transformer.lm_head.weight"]):
            raise ValueError(f"other weights: missing {missing}, unknown {unknown}")
        self.transformer.tie_weights()

    def attend(self, fused):
        """Takes the fused attention kernel, or its formula, everywhere."""
        Attention.fused = fused
        self.transformer.config._attn_implementation = "sdpa" if fused else "eager"

    def condition(self, cloud, picks):
        return self.output_proj(self.mesh_encoder.encoder(cloud, picks))

    def forward(self, b):
        """Scores of what follows each token that has a successor, [m, v]."""
        prefix = self.condition(b["cloud"], b["picks"])
        tokens = self.transformer.get_input_embeddings()(b["ids"]).to(prefix.dtype)
        # What is padded on the right is seen by nothing before it, so no mask is needed: the kernel has its own.
        out = self.decoder()(inputs_embeds=torch.cat([prefix, tokens], 1), use_cache=False).last_hidden_state
        # Only what is scored goes through the head.
        return self.transformer.lm_head(out[:, prefix.shape[1] : -1][b["scored"]])


class SkeletonModel(PrefixModel):
    def __init__(self, c, vocabulary):
        super().__init__()
        d = c["decoder"]
        if d["frozen_token"] is not None:
            raise ValueError("the twin trains all embeddings: model.decoder.frozen_token must not be set")
        self.mesh_encoder = nn.Module()
        self.mesh_encoder.encoder = Perceiver(c["shape"])
        self.output_proj = nn.Linear(c["shape"]["width"], d["width"])
        config = OPTConfig(
            vocab_size=vocabulary,
            hidden_size=d["width"],
            word_embed_proj_dim=d["width"],
            num_hidden_layers=d["layers"],
            ffn_dim=d["ffn"],
            num_attention_heads=d["heads"],
            max_position_embeddings=d["positions"],
            dropout=d["dropout"],
            attention_dropout=0.0,
            layerdrop=0.0,
            do_layer_norm_before=True,
            pad_token_id=None,
            bos_token_id=None,
            eos_token_id=None,
            attn_implementation="sdpa",
        )
        self.transformer = OPTForCausalLM(config)

    def decoder(self):
        return self.transformer.model.decoder

    @staticmethod
    def loss_of(config, logits, targets):
        if config["loss"]["distance"] or config["loss"]["next"] != 1:
            raise ValueError("the twin is written for cross-entropy alone")
        return each_loss(logits, targets, config["tokenizer"]["bins"], config["loss"]["spread"]).mean()


def padded(ids, lengths, cloud, picks):
    """A batch: ids [b, t], which of them are scored [b, t - 1], and what follows those [m]."""
    rows = nn.utils.rnn.pad_sequence(ids.split(lengths.tolist()), batch_first=True, padding_value=PAD)
    real = rows != PAD
    batch = {"cloud": cloud, "picks": picks, "ids": rows.clamp_min(0), "scored": real[:, 1:]}
    batch["targets"] = rows[:, 1:][batch["scored"]]
    return batch


def each_loss(logits, targets, bins, sigma):
    """Cross-entropies [m], with coordinates' targets spread over the cells around them."""
    logits = logits.float()
    if sigma == 0:
        return F.cross_entropy(logits, targets, reduction="none")
    reach = int(-(-2 * sigma // 1))
    offsets = torch.arange(-reach, reach + 1)
    weights = torch.exp(-0.5 * (offsets / sigma).square())
    beside = (targets.unsqueeze(1) + offsets).clamp(0, bins - 1)
    at = torch.where((targets < bins).unsqueeze(1), beside, targets.unsqueeze(1))
    return -(logits.log_softmax(-1).gather(1, at) @ (weights / weights.sum()))


ROLES = {"attention": r"\.attn\.c_|\.self_attn\.(q|k|v|o|out)_proj",
         "feed_forward": r"\.mlp\.(c_|gate_|up_|down_)|\.fc[12]\."}  # fmt: skip


class Trainer:
    """Network, optimizers, moving average and schedule of a config."""

    def __init__(self, config, net, weights, precision):
        self.config, self.train, optim = config, config["train"], config["train"]["optim"]
        self.net = net
        self.net.load(weights)
        roles = getattr(net, "ROLES", ROLES)
        wanted = re.compile("|".join(roles[role] for role in optim["muon"]) or "(?!)")
        is_muon = lambda name, p: p.dim() == 2 and bool(wanted.search(name))
        named = list(self.net.named_parameters())
        self.params = [p for _, p in named]
        if optim["weight_decay"] or not optim["muon_bf16"] or optim["muon_scale"] != "match_adamw":
            raise ValueError("the twin is written for the optimizer of the small experiments, which differs")
        self.muon = None
        muon = [p for n, p in named if is_muon(n, p)]
        if muon:
            self.muon = Muon(muon, optim["muon_lr"], optim["muon_momentum"], optim["muon_nesterov"])
        self.adamw = torch.optim.AdamW([p for n, p in named if not is_muon(n, p)], optim["adamw_lr"],
                                       tuple(optim["adamw_betas"]), optim["adamw_eps"], weight_decay=0.0,
                                       fused=True)  # fmt: skip
        self.optimizers = [o for o in (self.muon, self.adamw) if o]
        self.base = [o.param_groups[0]["lr"] for o in self.optimizers]
        self.average = [p.detach().clone() for p in self.params]
        self.bf16, self.steps = precision == "bf16", 0

    def loss(self, batch):
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            logits = self.net(batch)
        return self.net.loss_of(self.config, logits, batch["targets"])

    def step(self, batch):
        """One optimizer step; gives the loss."""
        return self.update(self.loss(batch))

    def update(self, loss):
        """A step down a loss, which it gives."""
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.params, self.train["optim"]["clip"], foreach=True)
        for optimizer, lr in zip(self.optimizers, self.base):
            optimizer.param_groups[0]["lr"] = lr * factor(self.train, self.steps)
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        decay = min(self.train["ema"], (1 + self.steps) / (10 + self.steps))
        torch._foreach_lerp_(self.average, [p.detach() for p in self.params], 1 - decay)
        self.steps += 1
        return loss.item()
