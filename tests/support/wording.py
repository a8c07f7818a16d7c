"""Numbers of a sentence, which a test asserts; its words stand in tests/data/sentences.json."""

import re


def numbers(sentence: str) -> list[float]:
    """The numbers of a sentence in their order; none of those within a name, such as p99."""
    return [float(found.replace(",", "")) for found in re.findall(r"(?<![\w.#])[+-]?\d[\d,]*(?:\.\d+)?", sentence)]
