"""How mistakes are put into words: values shown, suggestions, and pydantic's errors in plain
English."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from pipeline.graph.nodes import Steps

_LONGEST = 40


def shown(value: object) -> str:
    """A value as a mistake quotes it: short, and in the words of a YAML file."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (Mapping, list, tuple)):
        return "a mapping" if isinstance(value, Mapping) else "a list"
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 4] + "..." + text[-1]


def suggest(word: str, known: Iterable[str], *, or_list: bool = True) -> str:
    """The way out of a misspelling: ``; did you mean 'x'?``, or what there is, or nothing."""
    names = list(dict.fromkeys(known))
    if close := get_close_matches(word[:100], names, 1, 0.6):
        return f"; did you mean '{close[0]}'?"
    if or_list and 0 < len(names) <= 12:
        return "; known: " + ", ".join(f"'{name}'" for name in names)
    return ""


def listed(words: Sequence[str], last: str) -> str:
    """``a, b or c``"""
    words = list(dict.fromkeys(words))
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]


def numbered(number: int, thing: str) -> str:
    """``1 value``, ``2 values``"""
    return f"{number} {thing}{'' if number == 1 else 's'}"


#: What a value should have been, by the kind of pydantic's error.
_EXPECTED: dict[str, str] = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing", "decimal_type", "decimal_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("string_type", "bytes_type"), "text"),
    **dict.fromkeys(("list_type", "tuple_type", "set_type", "frozen_set_type"), "a list"),
    **dict.fromkeys(
        ("dict_type", "mapping_type", "model_type", "dataclass_type", "typed_dict_type"),
        "a mapping",
    ),
    "path_type": "a path",
    "none_required": "nothing",
}

#: Other errors as a whole sentence, from their context and the value.
_SENTENCES: dict[str, Callable[[Mapping[str, Any], Any], str]] = {
    "greater_than": lambda c, v: f"must be above {c['gt']:g}, not {shown(v)}",
    "greater_than_equal": lambda c, v: f"must be at least {c['ge']:g}, not {shown(v)}",
    "less_than": lambda c, v: f"must be below {c['lt']:g}, not {shown(v)}",
    "less_than_equal": lambda c, v: f"must be at most {c['le']:g}, not {shown(v)}",
    "multiple_of": lambda c, v: f"must be a multiple of {c['multiple_of']:g}, not {shown(v)}",
    "too_short": lambda c, v: (
        f"needs at least {numbered(c['min_length'], 'value')}, got {c['actual_length']}"
    ),
    "too_long": lambda c, v: (
        f"takes at most {numbered(c['max_length'], 'value')}, got {c['actual_length']}"
    ),
    "string_too_short": lambda c, v: (
        "is empty" if not v else f"needs at least {numbered(c['min_length'], 'character')}"
    ),
    "value_error": lambda c, v: str(c["error"]),
    "assertion_error": lambda c, v: str(c["error"]),
}


def explain(
    errors: Sequence[Mapping[str, Any]], value: Any, patterns: Mapping[str, str] | None = None
) -> list[tuple[Steps, str]]:
    """What pydantic found in `value` (plain lists and dicts), as places in it and sentences.

    Pydantic reports one error per member of a union, at a place that names the member; here they
    become one sentence at the place of the value: ``expected a number or text, got a list``.
    `patterns` says in words what text is that does not match a pattern.
    """
    by_place: dict[Steps, list[Mapping[str, Any]]] = {}
    for error in errors:
        by_place.setdefault(_place(error, value), []).append(error)
    deeper = {steps[:length] for steps in by_place for length in range(len(steps))}
    return [
        (steps, _sentence(found, _at(value, steps), patterns or {}))
        for steps, found in by_place.items()
        # A union's other members fail at the top; the member that fails further in was meant.
        if not (steps in deeper and all(error["type"] in _EXPECTED for error in found))
    ]


def _place(error: Mapping[str, Any], value: Any) -> Steps:
    steps: list[str | int] = []
    for step in error["loc"]:
        inside = isinstance(value, dict) and step in value
        inside |= isinstance(value, list) and isinstance(step, int) and 0 <= step < len(value)
        if inside:
            value = value[step]
            steps.append(step)
    return tuple(steps)


def _at(value: Any, steps: Steps) -> Any:
    for step in steps:
        value = value[step]
    return value


def _sentence(errors: Sequence[Mapping[str, Any]], value: Any, patterns: Mapping[str, str]) -> str:
    expected: list[str] = []
    for error in errors:
        kind, context = error["type"], error.get("ctx", {})
        if kind == "missing" or kind.startswith("missing_"):
            return f"misses '{error['loc'][-1]}'"
        if kind == "string_pattern_mismatch":
            pattern = context["pattern"]
            return f"{shown(error['input'])} {patterns.get(pattern, f'does not match {pattern}')}"
        if kind in _SENTENCES:
            return _SENTENCES[kind](context, error["input"])
        if kind in ("literal_error", "enum"):
            expected.append(context["expected"].replace(" or ", ", "))
        elif kind in _EXPECTED:
            expected.append(_EXPECTED[kind])
    if not expected:
        message: str = errors[0]["msg"]
        return f"{message[0].lower()}{message[1:]}, got {shown(value)}"
    options = [word for words in expected for word in words.split(", ")]
    sentence = f"expected {listed(options, 'or')}, got {_got(expected, value)}"
    if isinstance(value, str) and (
        close := get_close_matches(value[:100], [option.strip("'") for option in options], 1)
    ):
        sentence += f"; did you mean '{close[0]}'?"
    return sentence


def _got(expected: Sequence[str], value: Any) -> str:
    """A number or a bool that was put in quotes is what people do not see."""
    if not isinstance(value, str) or {"text", "a path"} & set(expected):
        return shown(value)
    try:
        float(value)
    except ValueError:
        quoted = value in ("true", "false")
    else:
        quoted = True
    return f"the text {shown(value)} (write it without quotes)" if quoted else shown(value)
