"""The channels of the ECG integral, all in one vector operation."""

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

CHANNELS = 8  # contiguous in every array
DOUBLE, INDEX = ir.DoubleType(), ir.IntType(64)
CHANNEL_VECTOR = ir.VectorType(DOUBLE, CHANNELS)


def _in_all(builder, value):
    """Give a number in every channel."""
    vector = ir.Constant(CHANNEL_VECTOR, ir.Undefined)
    for channel in range(CHANNELS):
        vector = builder.insert_element(vector, value, ir.Constant(INDEX, channel))
    return vector


@intrinsic
def add_to_rows(typing_context, array, rows, factors, source, first, shares):
    """Add factor·Σᵢ shareᵢ·source[first + i] to each of some rows of an array.

    Written in LLVM's own terms: of neither a loop over the channels nor one line for each does the
    compiler make vector operations.

    Parameters
    ----------
    array : (n, 8) array
        Added to; contiguous, in double precision.
    rows, factors : tuples of as many int and float
        The rows, and the factor of each.
    source : (..., 8) array
        Contiguous, in single or double precision; its rows are counted through all dimensions.
    first : int
        The first row of it that is used.
    shares : tuple of float
        What each row from that on is multiplied by.
    """
    if not array.layout == source.layout == "C":
        raise TypingError("rows of channels must be contiguous")

    def generate(context, builder, signature, arguments):
        def row(which, number):
            """Point to a row of an argument."""
            kind = signature.args[which]
            data = context.make_array(kind)(context, builder, arguments[which]).data
            vector = ir.VectorType(context.get_value_type(kind.dtype), CHANNELS)
            return builder.gep(builder.bitcast(data, vector.as_pointer()), [number])

        def items(which):
            kind = signature.args[which]
            found = cgutils.unpack_tuple(builder, arguments[which], kind.count)
            return [context.cast(builder, item, kind.dtype, wanted[which]) for item in found]

        wanted = {1: types.int64, 2: types.float64, 5: types.float64}
        total = ir.Constant(CHANNEL_VECTOR, None)
        for i, share in enumerate(items(5)):
            number = builder.add(arguments[4], ir.Constant(INDEX, i))
            values = builder.load(row(3, number), align=4)
            if values.type != CHANNEL_VECTOR:
                values = builder.fpext(values, CHANNEL_VECTOR)
            total = builder.fadd(total, builder.fmul(_in_all(builder, share), values))
        for number, factor in zip(items(1), items(2), strict=True):
            to = row(0, number)
            more = builder.fmul(_in_all(builder, factor), total)
            builder.store(builder.fadd(builder.load(to, align=8), more), to, align=8)
        return context.get_dummy_value()

    return types.void(array, rows, factors, source, types.int64, shares), generate
