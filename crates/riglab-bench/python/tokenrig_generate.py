"""Skeletons and skin codes drawn by transformers' `generate`, under the strict grammar."""

from serve import serve
from tokenrig import TokenRig
from unirig_generate import Grammar, Side, Strict


class WholeGrammar(Grammar):
    """A skeleton, then so many codes for each joint, then the end."""

    lacking_codes = None

    def allowed(self):
        if self.lacking_codes is None or self.done:
            return super().allowed()
        # One mask for all codes.
        if "codes" not in self.masks:
            mask = self.mask(False, ()).clone()
            mask[self.ids["codes_from"] : self.ids["end"]] = True
            self.masks["codes"] = mask
        return self.masks["codes"] if self.lacking_codes else self.mask(False, (self.ids["end"],))

    def accept(self, id):
        if self.lacking_codes is None:
            super().accept(id)
            if self.done:
                self.done, self.lacking_codes = False, self.joints * self.ids["codes_each"]
        elif self.lacking_codes:
            self.lacking_codes -= 1
        else:
            self.done = True


class WholeStrict(Strict):
    grammar = WholeGrammar


class WholeSide(Side):
    model, strict = TokenRig, WholeStrict


if __name__ == "__main__":
    side = WholeSide()
    serve({name: getattr(side, name) for name in ("open", "attend", "draw")})
