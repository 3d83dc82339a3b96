"""OpenUSD where usd-core is not installed: the error names it, and nothing else needs it."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rosplat_core.formats import InputError, axes, check_output, load, save, usd
from rosplat_core.splats import Splats


@pytest.mark.parametrize("ending", usd.SUFFIXES)
def test_without_usd_core_it_is_named(
    random_splats: Callable[..., Splats],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    ending: str,
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    for begin in (b"#usda 1.0\n", b"PXR-USDC", b"PK\x03\x04"):
        (tmp_path / f"a{ending}").write_bytes(begin)
        if usd.recognises(tmp_path / f"a{ending}", begin):
            for read in (load, axes):
                with pytest.raises(InputError, match=rf"a{ending}: .*pip install usd-core"):
                    read(tmp_path / f"a{ending}")
    with pytest.raises(InputError, match=rf"b{ending}: .*pip install usd-core"):
        save(tmp_path / f"b{ending}", random_splats(3))
    with pytest.raises(InputError, match="pip install usd-core"):
        check_output(tmp_path / f"b{ending}")
    assert not (tmp_path / f"b{ending}").exists()


def test_nobody_waits_for_usd_core_who_needs_none() -> None:
    code = "import sys, rosplat_core.formats; print('pxr' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"
