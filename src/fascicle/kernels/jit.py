"""Compilation of kernels by Numba, and operations that they use from LLVM directly."""

from functools import partial

from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

# `_nrt` is not among Numba's documented options: a version without it refuses it loudly. Numba's
# cache on disk sees changes of a kernel's own file only, not of those it imports.
#
# Compiled once per machine, and run outside Python's global lock
allocating_kernel = partial(njit, cache=True, nogil=True)

# Without reference counts, too, which took half of the sweep's time. Numba refuses to compile an
# allocation in such a kernel: the work arrays come from outside.
kernel = partial(allocating_kernel, _nrt=False)

CHANNELS = 8  # channels of the ECG integral; contiguous in every array


@intrinsic
def prefetch(typing_context, array, byte):
    """Fetch the cache line in which byte `byte` of a contiguous array lies; only a hint."""

    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.bitcast(data, ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, number, number, number])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        line = builder.gep(address, [arguments[1]])
        # to be read (0), more than once (3); data, not instructions (1)
        builder.call(fetch, [line, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic
def add_to_rows(typing_context, array, rows, factors, source, first, shares):
    """Add factor·Σᵢ shareᵢ·source[first + i] to each of some rows of an (n, 8) array of doubles.

    `rows` and `factors` are tuples of as many int and float, `shares` is a tuple of float; `source`
    is in single or double precision, its rows of 8 counted through all dimensions. The compiler
    makes vector operations neither of a loop over the channels nor of one line for each.
    """
    if not array.layout == source.layout == "C":
        raise TypingError("rows of channels must be contiguous")
    index, channels = ir.IntType(64), ir.VectorType(ir.DoubleType(), CHANNELS)

    def generate(context, builder, signature, arguments):
        def row(which, number):
            """Point to a row of an argument."""
            kind = signature.args[which]
            data = context.make_array(kind)(context, builder, arguments[which]).data
            vector = ir.VectorType(context.get_value_type(kind.dtype), CHANNELS)
            return builder.gep(builder.bitcast(data, vector.as_pointer()), [number])

        def items(which):
            kind = signature.args[which]
            parts = cgutils.unpack_tuple(builder, arguments[which], kind.count)
            return [context.cast(builder, item, kind.dtype, cast_types[which]) for item in parts]

        def in_all(value):
            """Repeat a number in every channel."""
            vector = ir.Constant(channels, ir.Undefined)
            for channel in range(CHANNELS):
                vector = builder.insert_element(vector, value, ir.Constant(index, channel))
            return vector

        cast_types = {1: types.int64, 2: types.float64, 5: types.float64}
        total = ir.Constant(channels, None)
        for i, share in enumerate(items(5)):
            number = builder.add(arguments[4], ir.Constant(index, i))
            values = builder.load(row(3, number), align=4)
            if values.type != channels:
                values = builder.fpext(values, channels)
            total = builder.fadd(total, builder.fmul(in_all(share), values))
        for number, factor in zip(items(1), items(2), strict=True):
            to = row(0, number)
            more = builder.fmul(in_all(factor), total)
            builder.store(builder.fadd(builder.load(to, align=8), more), to, align=8)
        return context.get_dummy_value()

    return types.void(array, rows, factors, source, types.int64, shares), generate
