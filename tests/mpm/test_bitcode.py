"""LLVM's functions in kernels (`mpm.arrays.bitcode`): every flow is computed with them."""

from mpm.arrays.bitcode import FILE, FUNCTIONS, MOVES, SIZES, version


def test_file_holds_what_stands_in_the_module() -> None:
    names = {f"{make.__name__}_{precision}_{version()}" for make in (*FUNCTIONS, *MOVES) for precision in SIZES}
    content = FILE.read_bytes()
    assert not {name for name in names if name.encode() not in content}
