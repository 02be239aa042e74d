"""This module gives kernels the processor instruction that loads memory into the cache before it is read."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def prefetch(context: Any, array: Any, index: Any) -> Any:
    """Prefetch the memory of an element of a flat array. Execution does not wait for it, and any index is safe."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        data = target.make_array(signature.args[0])(target, builder, arguments[0]).data
        address = builder.bitcast(builder.gep(data, [arguments[1]]), pointer)
        # arguments of LLVM's prefetch: read (0), keep in the nearest cache (3), data (1)
        builder.call(function, [address, number(0), number(3), number(1)])
        return target.get_dummy_value()

    return types.void(array, types.int64), generate
