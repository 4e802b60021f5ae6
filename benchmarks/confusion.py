"""Which materials are mistaken for which, over the pixels of many scenes."""

from collections import Counter

import numpy as np

MOST = 3  # wrong names listed for each material
LEAST = 0.005  # least share of its pixels to be listed


def named_as(answer, truth):
    """Counter of (true name, name given) for a Decomposition and its scene's Truth, without dead
    pixels."""
    seen = ~answer.dead
    names = (np.asarray(of.material_names)[of.material[seen]].tolist() for of in (truth, answer))
    return Counter(zip(*names, strict=True))


def confused(counts):
    """From a Counter of `named_as`, a row per true material, most pixels first: its share of all
    pixels, the share of its own that is named correctly, and {name: share} of its commonest wrong
    names."""
    of, rows = {}, []
    for (true, named), pixels in counts.items():
        of.setdefault(true, Counter())[named] += pixels
    for true in sorted(of, key=lambda name: (-of[name].total(), name)):
        total, right = of[true].total(), of[true].pop(true, 0)
        others = {n: p / total for n, p in of[true].most_common(MOST) if p >= LEAST * total}
        rows.append(
            {
                "material": true, "share": total / counts.total(), "right": right / total,
                "taken_for": others,
            }
        )  # fmt: skip
    return rows


def table(counts):
    """The same as lines of text."""
    yield f"{'material':20} {'pixels':>7} {'right':>7}  taken for"
    for r in confused(counts):
        others = ", ".join(f"{name} {share:.1%}" for name, share in r["taken_for"].items())
        yield f"{r['material']:20} {r['share']:7.1%} {r['right']:7.1%}  {others}"
