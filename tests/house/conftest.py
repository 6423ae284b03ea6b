"""What tests of the house share."""

from typing import Any

import pytest
from numba.core.codegen import CPUCodeLibrary


@pytest.fixture
def handed_to_llvm(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Name -> text of what is compiled from here on, before anything is optimised."""
    told: dict[str, str] = {}
    usual: Any = CPUCodeLibrary.add_ir_module

    def noted(library: Any, module: Any) -> None:
        told[module.name] = str(module)
        usual(library, module)

    monkeypatch.setattr(CPUCodeLibrary, "add_ir_module", noted)
    return told
