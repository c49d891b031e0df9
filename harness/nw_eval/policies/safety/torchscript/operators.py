"""Operators that a stranger's graph or script may call, by their names in torch's namespace `aten`.

All of them compute values from values: none reads files or addresses, draws random numbers, shows
memory that nobody wrote, or reaches outside its arguments' memory. In-place versions, with a `_`
appended, are included. The few that trust sizes which they are given run behind the checks of
`guards`. Absent on purpose, each tried with hostile arguments: `_reshape_alias` (believes any
size), `empty_like` (memory of others), `repeat_interleave` with repeats in a tensor (their sum
overflows), `set_`, `resize_`, `from_file`, `save`.
"""

from __future__ import annotations

_ARITHMETIC = """
    abs absolute acos acosh add addbmm addcdiv addcmul addmm asin asinh atan atan2 atanh baddbmm bmm
    ceil clamp clamp_max clamp_min clip cos cosh cross deg2rad div divide dot einsum erf exp expm1
    floor floor_divide fmax fmin fmod frac hypot inner lerp linalg_cross linear log log10 log1p
    log2 logit matmul maximum minimum mm mul multiply mv neg negative outer pow rad2deg reciprocal
    remainder round rsqrt rsub sgn sigmoid sign sin sinh sqrt square sub subtract tan tanh
    true_divide trunc
"""
_ACTIVATIONS = """
    celu elu gelu hardshrink hardsigmoid hardswish hardtanh leaky_relu log_sigmoid mish prelu relu
    relu6 selu
    silu softmax _softmax softplus softshrink softsign log_softmax _log_softmax threshold glu
    dropout
    feature_dropout alpha_dropout feature_alpha_dropout
"""
_LAYERS = """
    adaptive_avg_pool1d adaptive_avg_pool2d adaptive_avg_pool3d _adaptive_avg_pool2d
    adaptive_max_pool1d adaptive_max_pool2d avg_pool1d avg_pool2d avg_pool3d batch_norm bilinear
    channel_shuffle _native_batch_norm_legit_no_training convolution _convolution conv1d
    conv2d conv3d conv_transpose1d
    conv_transpose2d conv_transpose3d
    embedding group_norm native_group_norm gru instance_norm layer_norm native_layer_norm lstm
    rms_norm max_pool1d max_pool2d max_pool2d_with_indices max_pool3d rnn_relu rnn_tanh gru_cell
    lstm_cell rnn_tanh_cell rnn_relu_cell im2col pairwise_distance
    scaled_dot_product_attention _scaled_dot_product_flash_attention_for_cpu
    _native_multi_head_attention _transformer_encoder_layer_fwd
    upsample_bicubic2d upsample_bilinear2d upsample_linear1d upsample_nearest1d upsample_nearest2d
    upsample_nearest3d upsample_trilinear3d _upsample_nearest_exact1d _upsample_nearest_exact2d
    _upsample_nearest_exact3d pixel_shuffle
    pixel_unshuffle grid_sampler_2d linalg_vector_norm linalg_norm norm normalize cosine_similarity
"""
_SHAPES = """
    alias as_strided broadcast_to cat chunk clone concat concatenate contiguous copy detach
    detach_copy diagonal
    expand expand_as expand_copy flatten flip gather hstack index index_put index_select
    lift_fresh_copy masked_fill masked_select movedim narrow numpy_T mT pad constant_pad_nd permute
    permute_copy one_hot ravel
    reflection_pad1d reflection_pad2d replication_pad1d replication_pad2d repeat
    repeat_interleave reshape reshape_as roll scatter select select_copy slice slice_copy
    split split_with_sizes
    squeeze squeeze_copy stack swapaxes swapdims t take_along_dim tensor_split tile transpose triu
    tril unbind unflatten unfold
    unsafe_chunk unsafe_split unsqueeze unsqueeze_copy view view_as view_copy _unsafe_view
    vstack where zero fill
    slice_scatter select_scatter to _to_copy type_as
"""
_REDUCTIONS = """
    all amax amin any argmax argmin argsort cumsum cumprod logsumexp max mean median min prod sort
    std sum topk var var_mean std_mean
"""
_COMPARISONS = """
    bitwise_and bitwise_not bitwise_or eq equal ge gt isclose isfinite isinf isnan le logical_and
    logical_not logical_or logical_xor lt ne nan_to_num
"""
_FACTORIES = """
    arange full full_like linspace new_full new_ones new_zeros ones ones_like
    scalar_tensor zeros zeros_like eye
"""
FACTORIES = frozenset(_FACTORIES.split())
"""Those that make tensors from sizes, on a device."""
# Checks that the exporter leaves in a graph.
_CHECKS = "_assert_tensor_metadata"

OPERATORS = FACTORIES.union(
    *(
        names.split()
        for names in (
            _ARITHMETIC,
            _ACTIVATIONS,
            _LAYERS,
            _SHAPES,
            _REDUCTIONS,
            _COMPARISONS,
            _CHECKS,
        )
    )
)
"""Operators on tensors, for graphs and for scripts."""

_REFUSED = """
    gru.data lstm.data repeat_interleave.Tensor repeat_interleave.self_Tensor rnn_relu.data
    rnn_tanh.data
"""
REFUSED_OVERLOADS = frozenset(_REFUSED.split())
"""Forms of an operator that may not run though others of its name may."""

# What TorchScript writes for sizes, lists, dicts, strings, plain numbers and conditions.
_LANGUAGE = """
    __and__ __contains__ __derive_index __getitem__ __is__ __isnot__ __not__ __or__ __range_length
    __round_to_zero_floordiv __xor__ _set_item _unwrap_optional Delete append as_tensor clear count
    device dict dim element_size endswith extend fabs find floordiv format get insert is_complex
    is_contiguous is_floating_point is_grad_enabled is_autocast_enabled is_nonzero is_same_size item
    items join keys len list lower numel percentFormat pop replace result_type reverse
    set_grad_enabled size sorted startswith str stride strip sym_size tensor update upper values
"""
_RANDOM = """
    bernoulli binomial exponential multinomial normal poisson rand rand_like
    randint randint_like randn randn_like randperm rrelu uniform
"""
_CARELESS = """
    _nested_tensor_from_mask _upsample_bicubic2d_aa _upsample_bilinear2d_aa _upsample_lanczos2d_aa
    to_padded_tensor
"""
NEVER_RUN = {
    **dict.fromkeys((_RANDOM + _CARELESS).split(), "never"),
    "_nested_tensor_from_mask_left_aligned": "never_bool",
    "fractional_max_pool2d": "never_two",
}
"""What torch's own layers name in branches that a policy does not get to, or got to in training.

A script may have such a call, in whose place a function of `guards` is compiled that fails.
"""

SCRIPT_OPERATORS = OPERATORS.union(_LANGUAGE.split())
"""What a script may call as `torch.NAME`."""

_CASTS = "Bool Float FloatImplicit Int IntImplicit ScalarImplicit"
COMPILED_OPERATORS = SCRIPT_OPERATORS.union(_CASTS.split())
"""What stands in compiled scripts: the above, and what torch makes of `int(x)` and its kind."""

_QUESTIONS = """
    NumToTensor RaiseException abs data device dtype is_cpu is_cuda is_nested is_quantized is_sparse
    itemsize layout max min ndim requires_grad shape type unchecked_unwrap_optional
"""
PRIM_OPERATORS = frozenset(_QUESTIONS.split())
"""What a script may call as `ops.prim.NAME`: questions to tensors, and how it fails."""

_STRUCTURE = """
    CallFunction CallMethod Constant CreateObject DictConstruct Enter Exit GetAttr If
    ListConstruct ListUnpack Loop SetAttr TupleConstruct TupleIndex TupleSlice TupleUnpack
    Uninitialized isinstance tolist unchecked_cast
"""
STRUCTURE = frozenset(_STRUCTURE.split())
"""What a compiled script is made of besides calls, in torch's namespace `prim`."""


def may_run(name: str, allowed: frozenset[str]) -> bool:
    """Whether an operator, or the one of which it is the in-place version, is among those."""
    return name in allowed or (name.removesuffix("_") in allowed and not name.endswith("__"))
