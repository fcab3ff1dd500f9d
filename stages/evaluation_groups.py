"""Which classes count as one in an evaluation: the columns of a paper's table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from pipeline.errors import DataError
from stages.taxonomy import load_taxonomy

#: The groupings that come with Overflight.
SHIPPED = Path(__file__).with_name("evaluation_groups.yaml")


def load_groups(choice: str) -> dict[str, list[int]]:
    """The class ids of each group, by its name: a shipped grouping, or a file that holds one.

    Raises DataError with what is wrong and which groupings there are.
    """
    shipped: dict[str, Any] = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    place, groups = f"{SHIPPED.name}: {choice}", shipped.get(choice)
    if groups is None:
        place = choice
        try:
            groups = yaml.safe_load(Path(choice).read_text(encoding="utf-8"))
        except OSError:
            raise DataError(
                f"no grouping '{choice}': neither a file nor one of {', '.join(shipped)}"
            ) from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise DataError(f"{place}: not YAML ({error})") from None
    taxonomy, taken = load_taxonomy(), set[str]()
    if not isinstance(groups, dict) or not all(isinstance(v, list) for v in groups.values()):
        raise DataError(f"{place}: needs a list of classes for each group, as {SHIPPED.name} has")
    for name, members in groups.items():
        for member in members:
            if member not in taxonomy.names or member == taxonomy.names[0] or member in taken:
                what = "is in two groups" if member in taken else "is no class that can be judged"
                raise DataError(
                    f"{place}: {name}: '{member}' {what} (classes: {', '.join(taxonomy.names[1:])})"
                )
            taken.add(member)
    return {
        str(name): [taxonomy.id(member) for member in members] for name, members in groups.items()
    }
