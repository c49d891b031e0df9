"""The messages and fields of onnx.proto, and the operators that a policy may use.

Left out, and so refused: fields for several devices, maps and opaque types, and those that no
version of the format has given a meaning yet.
"""

from __future__ import annotations

from nw_eval.policies.safety.onnx.protobuf import table

ONNX = table({
    "Model": """1 ir_version int, 2 producer_name text, 3 producer_version text, 4 domain text,
        5 model_version int, 6 doc_string text, 7 graph Graph, 8 opset_import Opset*,
        14 metadata_props Entry*, 20 training_info bytes*, 25 functions Function*""",
    "Graph": """1 node Node*, 2 name name, 5 initializer Tensor*, 10 doc_string text,
        11 input ValueInfo*, 12 output ValueInfo*, 13 value_info ValueInfo*,
        14 quantization_annotation Annotation*, 15 sparse_initializer bytes*,
        16 metadata_props Entry*""",
    "Function": """1 name name, 4 input name*, 5 output name*, 6 attribute name*, 7 node Node*,
        8 doc_string text, 9 opset_import Opset*, 10 domain name, 11 attribute_proto Attribute*,
        12 value_info ValueInfo*, 13 overload name, 14 metadata_props Entry*""",
    "Node": """1 input name*, 2 output name*, 3 name name, 4 op_type name, 5 attribute Attribute*,
        6 doc_string text, 7 domain name, 8 overload name, 9 metadata_props Entry*""",
    "Attribute": """1 name name, 2 f float, 3 i int, 4 s bytes, 5 t Tensor, 6 g Graph,
        7 floats float*, 8 ints int*, 9 strings bytes*, 10 tensors Tensor*, 11 graphs Graph*,
        13 doc_string text, 14 tp Type, 15 type_protos Type*, 20 type int, 21 ref_attr_name name,
        22 sparse_tensor bytes, 23 sparse_tensors bytes*""",
    "Tensor": """1 dims int*, 2 data_type int, 3 segment bytes, 4 float_data float*,
        5 int32_data int*, 6 string_data bytes*, 7 int64_data int*, 8 name name, 9 raw_data bytes,
        10 double_data double*, 11 uint64_data int*, 12 doc_string text, 13 external_data bytes*,
        14 data_location int, 16 metadata_props Entry*""",
    "ValueInfo": "1 name name, 2 type Type, 3 doc_string text, 4 metadata_props Entry*",
    "Type": """1 tensor_type TensorType, 4 sequence_type Element, 6 denotation name,
        9 optional_type Element""",
    "TensorType": "1 elem_type int, 2 shape Shape",
    "Element": "1 elem_type Type",
    "Shape": "1 dim Dim*",
    "Dim": "1 dim_value int, 2 dim_param name, 3 denotation name",
    "Entry": "1 key name, 2 value text",
    "Opset": "1 domain name, 2 version int",
    "Annotation": "1 tensor_name name, 2 quant_parameter_tensor_names Entry*",
})  # fmt: skip
"""Fields by number, with ONNX's names. What is refused wherever it stands is left as bytes."""

STANDARD = frozenset({"", "ai.onnx", "ai.onnx.ml"})
"""Domains whose operators are all arithmetic: they open no file and call no code."""
MICROSOFT = "com.microsoft"
"""The domain of the operators that onnxruntime adds to the standard."""
FUSED = frozenset({
    "Attention", "BiasGelu", "BiasSoftmax", "DequantizeLinear", "DynamicQuantizeLSTM",
    "DynamicQuantizeMatMul", "EmbedLayerNormalization", "FastGelu", "FusedConv", "FusedGemm",
    "FusedMatMul", "Gelu", "GroupQueryAttention", "Inverse", "MatMulIntegerToFloat",
    "MatMulNBits", "MultiHeadAttention", "NhwcMaxPool", "QAttention", "QGemm", "QLinearAdd",
    "QLinearAveragePool", "QLinearConcat", "QLinearConv", "QLinearGlobalAveragePool",
    "QLinearLeakyRelu", "QLinearMul", "QLinearReduceMean", "QLinearSigmoid", "QLinearSoftmax",
    "QLinearWhere", "QuantizeLinear", "QuickGelu", "RotaryEmbedding", "SkipLayerNormalization",
    "SkipSimplifiedLayerNormalization", "TransposeMatMul", "Trilu",
})  # fmt: skip
"""What onnxruntime's optimiser and quantiser write in place of standard operators."""
