"""Checks of the shapes in annotations: of what functions take and return, and of the fields of data types.

Only annotations that name a shape (``Float[Array, "N 2"]``) are checked; other types are left to pyright. The import
hook is one of our own for two reasons. jaxtyping's also checks the fields of dataclasses whenever one is made, but JAX
makes them of whatever it maps a tree to: axes, strings, None. And it wraps every function, which makes tracing slower;
this one wraps module-level functions and methods that have a shape in their signature.
"""

import ast
import dataclasses
import inspect
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from typing import Any, get_args, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, jaxtyped

KINDS = {"Bool", "Complex", "Float", "Inexact", "Int", "Integer", "Key", "Num", "Real", "Shaped", "UInt", "UInt8"}
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int is a float


def install(package: str) -> None:
    """Has the shapes of a package's functions checked from now on; call it before the package is imported."""
    assert package not in sys.modules, f"{package} is imported already, so its shapes cannot be checked"
    sys.meta_path.insert(0, _Finder(package))


def check_fields(value: Any) -> int:
    """The number of fields checked in a tree of dataclasses: each letter has to mean the same number in all of them."""
    with jaxtyped("context"):
        return _check_fields(value, type(value).__name__)


def checked(function: Any) -> Any:
    """The function, checked for shapes; the hook puts this decorator on functions."""
    return jaxtyped(function, typechecker=_check_shapes)


def _check_fields(value: Any, path: str) -> int:
    hints = get_type_hints(type(value))
    number = 0
    for field in dataclasses.fields(value):
        part, hint = getattr(value, field.name), hints[field.name]
        if has_shape(hint):
            assert any(isinstance(part, option) for option in get_args(hint) or (hint,)), (
                f"{path}.{field.name} is {getattr(part, 'dtype', type(part))}{getattr(part, 'shape', '')}, not {hint}"
            )
            number += 1
        elif dataclasses.is_dataclass(part):
            number += _check_fields(part, f"{path}.{field.name}")
    return number


def has_shape(hint: Any) -> bool:
    """Whether an annotation names the shape of an array."""
    if isinstance(hint, list | tuple):
        return any(has_shape(part) for part in hint)
    return inspect.isclass(hint) and issubclass(hint, AbstractArray) or any(has_shape(part) for part in get_args(hint))


def _check_shapes(function: Any) -> Any:
    hints = function.__annotations__
    function.__annotations__ = {name: hint if has_shape(hint) else Any for name, hint in hints.items()}
    return _check(function)


class _Finder(MetaPathFinder):
    def __init__(self, package: str):
        self.package = package

    def find_spec(self, fullname, path=None, target=None):
        if fullname.split(".")[0] != self.package:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


class _Loader(SourceFileLoader):
    def get_code(self, fullname):
        """As compiled from the source each time: what lies in __pycache__ is not checked."""
        data = self.get_data(self.path)
        if b"jaxtyping" not in data:
            return super().get_code(fullname)
        tree = ast.parse(data, self.path)
        for scope in (tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))):
            for node in scope.body:
                if isinstance(node, ast.FunctionDef) and _names_shape(node):
                    decorator = ast.parse("__import__('support.shapes').shapes.checked", mode="eval").body
                    node.decorator_list.append(ast.copy_location(decorator, node))
        return compile(ast.fix_missing_locations(tree), self.path, "exec", dont_inherit=True)


def _names_shape(node: ast.FunctionDef) -> bool:
    signature = [node.args, *([node.returns] if node.returns else [])]
    return any(isinstance(part, ast.Name) and part.id in KINDS for top in signature for part in ast.walk(top))
