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

    Raises:
        InputError: for a missing or malformed file, an unknown or missing key, or a value of another type,
            naming the file and the key, what was found and what is allowed.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({type(error).__name__})") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not valid TOML ({error})") from error
    return build(cls, table, str(path))


def build(cls: type[T], table: dict[str, Any], where: str) -> T:
    """Build a dataclass from a table; ``where`` prefixes the messages."""
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    _check_keys(table, fields, where)
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


def changed(spec: T, table: Mapping[str, Any], where: str) -> T:
    """A dataclass with some values of a table in place of its own; tables within it change nested ones.

    Raises:
        InputError: for an unknown key or a value of another type, or what the dataclass itself refuses;
            ``where`` prefixes the messages.
    """
    hints = typing.get_type_hints(type(spec))
    _check_keys(table, hints, where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        held = getattr(spec, key)
        if dataclasses.is_dataclass(held) and isinstance(value, dict):
            values[key] = changed(held, value, f"{where}: {key}")
        else:
            values[key] = _convert(hints[key], value, f"{where}: {key}")
    try:
        return dataclasses.replace(spec, **values)  # type: ignore[type-var]
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _check_keys(table: Mapping[str, Any], known: Mapping[str, Any], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; {nearest(key, known)}")


def added(default: Any) -> Any:
    """A field that came after data sets had been made: at its default it is left out of ``as_dict``.

    So specs that do not use it keep the hash that they had, and data sets made before are gone on with.
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
        return build(typing.cast(type[Any], hint), value, where)
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
