"""TokenRig as PyTorch's users write it: the decoder is Qwen3 as transformers has it, with one softmax over skeleton
tokens and codes, behind the shape encoder of the skeleton model.
"""

import torch
from torch import nn
from transformers import Qwen3Config, Qwen3ForCausalLM

from unirig_skeleton import Perceiver, PrefixModel, each_loss


class TokenRig(PrefixModel):
    def __init__(self, c, vocabulary):
        super().__init__()
        d = c["decoder"]
        told = c["tell_joint"] or c["tell_region"] or c["tell_place"]
        if c["head"] != "flat" or told or d["dropout"]:
            raise ValueError('the twin has head = "flat", nothing told and dropout = 0, as the paper')
        self.mesh_encoder = nn.Module()
        self.mesh_encoder.encoder = Perceiver(c["shape"])
        norm = nn.RMSNorm(d["width"], eps=torch.finfo(torch.float32).eps)
        self.output_proj = nn.Sequential(nn.Linear(c["shape"]["width"], d["width"]), norm)
        config = Qwen3Config(
            vocab_size=vocabulary,
            hidden_size=d["width"],
            intermediate_size=d["ffn"],
            num_hidden_layers=d["layers"],
            num_attention_heads=d["heads"],
            num_key_value_heads=d["kv_heads"],
            head_dim=d["head_width"],
            max_position_embeddings=d["positions"],
            rms_norm_eps=d["rms_eps"],
            rope_parameters={"rope_type": "default", "rope_theta": d["rope_theta"]},
            tie_word_embeddings=True,
            attention_dropout=0.0,
            pad_token_id=None,
            bos_token_id=None,
            eos_token_id=None,
            attn_implementation="sdpa",
        )
        self.transformer = Qwen3ForCausalLM(config)

    def decoder(self):
        return self.transformer.model

    @staticmethod
    def loss_of(config, logits, targets):
        """One mean over all tokens, each part with its weight; coordinates' targets are spread."""
        c = config["loss"]
        if c["skin_warmup"] != [0.0, 0.0]:
            raise ValueError("the twin is written for a skin part that counts from the start")
        each = each_loss(logits, targets, config["tokenizer"]["bins"], c["spread"])
        is_skeleton = targets < config["skeleton_ids"]
        return (each * torch.where(is_skeleton, c["skeleton"], c["skin"])).mean()
