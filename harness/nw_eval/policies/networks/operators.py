"""Operators of `torch.ops.aten` that an exported graph may call.

All of them compute tensors from tensors: none reads files, draws random numbers or changes the
size of its arguments. In-place versions, with a `_` appended, are included.
"""

from __future__ import annotations

_ARITHMETIC = """
    abs add addcdiv addcmul addmm baddbmm bmm ceil clamp clamp_max clamp_min cos cosh div dot erf
    exp expm1 floor floor_divide fmod linear log log10 log1p log2 matmul maximum minimum mm mul
    mv neg
    pow reciprocal remainder round rsqrt rsub sigmoid sign sin sinh sqrt square sub tan
    tanh true_divide trunc acos acosh asin asinh atan atan2 atanh cross outer einsum hypot lerp sgn
"""
_ACTIVATIONS = """
    celu elu gelu hardsigmoid hardswish hardtanh leaky_relu log_sigmoid mish prelu relu relu6 selu
    silu softmax _softmax softplus softsign log_softmax _log_softmax threshold glu dropout
    feature_dropout alpha_dropout
"""
_LAYERS = """
    adaptive_avg_pool1d adaptive_avg_pool2d _adaptive_avg_pool2d adaptive_max_pool2d avg_pool1d
    avg_pool2d batch_norm _native_batch_norm_legit_no_training convolution conv1d conv2d conv3d
    embedding group_norm native_group_norm gru instance_norm layer_norm native_layer_norm lstm
    rms_norm max_pool1d max_pool2d max_pool2d_with_indices rnn_relu rnn_tanh gru_cell
    lstm_cell rnn_tanh_cell
    scaled_dot_product_attention _scaled_dot_product_flash_attention_for_cpu
    _native_multi_head_attention upsample_bilinear2d upsample_nearest2d pixel_shuffle
    pixel_unshuffle grid_sampler_2d linalg_vector_norm norm normalize cosine_similarity
"""
_SHAPES = """
    alias as_strided broadcast_to cat chunk clone concat contiguous copy detach detach_copy diagonal
    expand expand_as expand_copy flatten flip gather hstack index index_put index_select
    lift_fresh_copy masked_fill movedim narrow numpy_T pad constant_pad_nd permute permute_copy
    reflection_pad1d reflection_pad2d replication_pad1d replication_pad2d repeat
    repeat_interleave reshape roll scatter select select_copy slice slice_copy
    split split_with_sizes
    squeeze squeeze_copy stack t take_along_dim tile transpose triu tril unbind unflatten unfold
    unsafe_split unsqueeze unsqueeze_copy view view_as view_copy _unsafe_view vstack where zero fill
    slice_scatter select_scatter to _to_copy type_as movedim _reshape_alias
"""
_REDUCTIONS = """
    all amax amin any argmax argmin argsort cumsum cumprod logsumexp max mean min prod sort std sum
    topk var var_mean std_mean
"""
_COMPARISONS = """
    bitwise_and bitwise_not bitwise_or eq ge gt isfinite isinf isnan le logical_and logical_not
    logical_or logical_xor lt ne nan_to_num
"""
_FACTORIES = """
    arange empty_like full full_like linspace new_full new_ones new_zeros ones ones_like
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
