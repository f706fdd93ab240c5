"""LLVM's functions in kernels (`mpm.arrays.bitcode`): every flow is computed with them."""

import re

from mpm.arrays.bitcode import FILE, template, version


def test_file_holds_what_stands_in_the_module() -> None:
    names, content = re.findall(r"define void @(\w+)VERSION", template()), FILE.read_bytes()
    assert len(names) == 20
    assert not [name for name in names if f"{name}{version()}".encode() not in content]
