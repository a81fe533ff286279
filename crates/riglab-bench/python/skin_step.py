"""Training steps of the twin of the skin stage on batches and weights given in a file."""

from fsq_cvae import prepare, read_tensors
from serve import peak_memory_mb, serve
from unirig_skin import SkinModel, SkinTrainer
from unirig_step import Side as Steps


class Side(Steps):
    def open(self, file, config, threads, fused):
        """Reads weights and batches; gives the loss of each batch."""
        prepare(threads)
        tensors = read_tensors(file)
        weights = {k[2:]: v for k, v in tensors.items() if k.startswith("w/")}
        rigs = {}
        for key, value in tensors.items():
            if not key.startswith("w/"):
                batch, rig, name = key.split("/")
                value = value.bool() if name in ("frozen", "swinging") else value
                rigs.setdefault(int(batch), {}).setdefault(int(rig), {})[name] = value
        self.batches = [[rigs[b][r] for r in sorted(rigs[b])] for b in sorted(rigs)]
        self.trainer = SkinTrainer(config, SkinModel(config["model"]), weights, "fp32")
        return self.first(fused)


if __name__ == "__main__":
    side = Side()
    serve({name: getattr(side, name) for name in ("open", "fused_is_faster", "run", "memory")})
