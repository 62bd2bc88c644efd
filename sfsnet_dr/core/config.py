"""Frozen dataclasses from TOML: every key known, every value of its field's type, every error one line."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tomllib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from sfsnet_dr.core.errors import InputError, nearest

T = TypeVar("T")

_ADDED = "added"


def load_toml(cls: type[T], path: Path | str) -> T:
    """Read a TOML file into a frozen dataclass; tables become nested dataclasses, arrays tuples.

    ``extends = "base.toml"`` at the top of a file names another file, relative to it. It is read first,
    and the keys of this one replace its keys, table by table. Arrays are replaced whole.

    A dataclass may list former key names in a class attribute ``RENAMED: ClassVar[Mapping[str, str]]``
    (old name to new name). A former name is refused with the new one.

    Raises:
        InputError: for a missing or malformed file, an unknown, renamed or missing key, a value of another
            type, or files that extend each other in a circle; it names the file and the key, what was found
            and what is allowed.
    """
    return build_dataclass(cls, read_toml(path), str(path))


def read_toml(path: Path | str) -> dict[str, Any]:
    """The tables of a TOML file, with those of the files that it ``extends`` below them.

    Raises:
        InputError: for a missing or malformed file, or files that extend each other in a circle.
    """
    return _read_extended(Path(path), ())


def _read_extended(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    table = _parse_toml(path)
    base = table.pop("extends", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise InputError(f"{path}: extends: {base!r} found, the path of one TOML file is needed")
    chain = (*below, path.resolve())
    parent = path.parent / base
    if not parent.is_file():
        raise InputError(f"{path}: extends: {parent}: no such file")
    if parent.resolve() in chain:
        raise InputError(f"{path}: extends: {base!r} leads back to a file that extends this one")
    return _merge_tables(_read_extended(parent, chain), table)


def _merge_tables(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in change.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = _merge_tables(merged[key], value)
        else:
            merged[key] = value
    return merged


def _parse_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({type(error).__name__})") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not valid TOML ({error})") from error


def build_dataclass(cls: type[T], table: dict[str, Any], where: str) -> T:
    """Build a dataclass from a table; ``where`` prefixes the messages."""
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    _check_keys(cls, table, where)
    required = [
        name
        for name, field in fields.items()
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]
    for name in required:
        if name not in table:
            raise InputError(f"{where}: key {name!r} is missing")
    values = {key: _convert(hints[key], value, f"{where}: {key}") for key, value in table.items()}
    return cls(**values)


def with_changes(spec: T, table: Mapping[str, Any], where: str) -> T:
    """A dataclass with some values of a table in place of its own; tables within it change nested ones.

    Raises:
        InputError: for an unknown key or a value of another type, or what the dataclass itself refuses;
            ``where`` prefixes the messages.
    """
    hints = typing.get_type_hints(type(spec))
    _check_keys(type(spec), table, where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        held = getattr(spec, key)
        if dataclasses.is_dataclass(held) and isinstance(value, dict):
            values[key] = with_changes(held, value, f"{where}: {key}")
        else:
            values[key] = _convert(hints[key], value, f"{where}: {key}")
    try:
        return dataclasses.replace(spec, **values)  # type: ignore[type-var]
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _check_keys(cls: type[Any], table: Mapping[str, Any], where: str) -> None:
    known = {field.name for field in dataclasses.fields(cls)}
    renamed: Mapping[str, str] = getattr(cls, "RENAMED", {})
    for key in table:
        if key in renamed:
            raise InputError(f"{where}: {key!r} is now called {renamed[key]!r}")
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; {nearest(key, known)}")


def added_field(default: Any) -> Any:
    """A field that came after data sets had been made: at its default it is left out of ``as_dict``.

    So specs that do not use it keep the hash that they had, and data sets made before can be continued.
    """
    return dataclasses.field(default=default, metadata={_ADDED: True})


def as_dict(spec: Any) -> dict[str, Any]:
    """A dataclass as plain JSON values, for records and hashes."""
    plain: dict[str, Any] = json.loads(json.dumps(_plain(spec)))
    return plain


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(field, getattr(value, field.name)) for field in dataclasses.fields(value)]
        used = [(f.name, held) for f, held in fields if not (_ADDED in f.metadata and held == f.default)]
        return {name: _plain(held) for name, held in used}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def fingerprint(spec: Any) -> str:
    """A short hash of every value of a dataclass: equal specs, equal fingerprints."""
    text = json.dumps(as_dict(spec), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _convert(hint: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, dict):
            raise InputError(f"{where}: {value!r} found, a table is needed")
        return build_dataclass(typing.cast(type[Any], hint), value, where)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return _convert(next(a for a in arguments if a is not type(None)), value, where)
    if origin is typing.Literal:
        if value not in arguments:
            raise InputError(f"{where}: {value!r} found; {nearest(str(value), map(str, arguments))}")
        return value
    if origin is dict:
        if not isinstance(value, dict):
            raise InputError(f"{where}: {value!r} found, a table is needed")
        return value
    if origin is tuple:
        return _convert_tuple(arguments, value, where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not hint:
        raise InputError(f"{where}: {value!r} found, {getattr(hint, '__name__', hint)} is needed")
    return value


def _convert_tuple(arguments: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise InputError(f"{where}: {value!r} found, an array is needed")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        return tuple(_convert(arguments[0], item, where) for item in value)
    if len(value) != len(arguments):
        raise InputError(f"{where}: {len(value)} values found, {len(arguments)} are needed")
    return tuple(_convert(hint, item, where) for hint, item in zip(arguments, value, strict=True))
