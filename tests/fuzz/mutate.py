"""Mutators: a valid file in, a damaged, extreme or malicious one out, by a seeded generator.

Bytes are flipped, cut, repeated and spliced; texts lose, repeat and exchange tokens and get the
numbers and words that readers stumble over; archives are changed inside and packed again, so that
the mutation gets past their checksums.
"""

import contextlib
import gzip
import io
import re
import zipfile
import zlib

NUMBERS = (
    b"0", b"-1", b"1e7", b"1e12", b"1e300", b"-1e300", b"1e-300", b"nan", b".nan", b".inf",
    b"-.inf", b"2147483648", b"18446744073709551616", b"999999999999", b"0x7f", b"1e",
    b"--1", b"1_000", b"",
)  # fmt: skip
WORDS = (
    b"../../outside", b"/etc/passwd", b"..", b"a/../../b", b"C:\\x", b"\x00", b"\x1b[2J",
    b"::error::x", b"!!python/object/apply:os.system [touch ran]", b"&a [*a, *a]", b"<<: *a",
    b"{}", b"[]", b"null", b"true", b"~", b"- - - -", b"x" * 300, b"\xff\xfe", b"\xe2\x80\xae",
    b"'", b'"', b"%", b"\t", b"\r\n", b"*", b"hurdles/*", b"neverwhere:/", b"python:os:system",
    b"1, 2", b"<!ENTITY x 'y'>", b"&x;",
)  # fmt: skip
_RAW = (b"\0", b"\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\0" * 8)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_TOKEN = re.compile(rb"[A-Za-z0-9_./@:-]+|\s+|.", re.DOTALL)


def mutate(data, rng, name=""):
    """Return a mutation of a file's bytes; what kind of file it is shows by content and name."""
    if name.endswith(".onnx") and rng.random() < 0.6:
        return _inside_onnx(data, rng)
    if name.endswith(".mcap") and rng.random() < 0.6:
        return _inside_log(data, rng)
    if data[:2] == b"PK" and rng.random() < 0.7:
        return _inside_archive(data, rng)
    if data[:2] == b"\x1f\x8b" and rng.random() < 0.5:
        with contextlib.suppress(OSError, EOFError, zlib.error):
            return gzip.compress(mutate(gzip.decompress(data), rng), 1)
    if _is_text(data) and rng.random() < 0.75:
        return mutate_text(data, rng)
    return mutate_bytes(data, rng)


def mutate_bytes(data, rng):
    """Flip, overwrite, cut, repeat and splice; the front of a file gets most of it."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        span = len(data) if rng.random() < 0.4 else min(len(data), 1200)
        if span == 0:
            break
        place = int(rng.integers(span))
        match int(rng.integers(7)):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place] = int(rng.integers(256))
            case 2:
                end = len(data) if rng.random() < 0.3 else place + int(rng.integers(1, 20))
                del data[place:end]
            case 3:
                number = _RAW[int(rng.integers(len(_RAW)))]
                data[place : place + len(number)] = number
            case 4:
                data[place:place] = data[place : place + int(rng.integers(1, 64))]
            case 5:
                other = int(rng.integers(len(data)))
                size = int(rng.integers(1, 40))
                data[place : place + size] = data[other : other + size]
            case _:
                word = (*NUMBERS, *WORDS)[int(rng.integers(len(NUMBERS) + len(WORDS)))]
                data[place:place] = word
    return bytes(data)


def mutate_text(data, rng):
    """Exchange numbers and words, lose, repeat and swap lines and tokens."""
    for _ in range(int(rng.integers(1, 4))):
        match int(rng.integers(7)):
            case 0 | 1:
                data = _replace_one(_NUMBER, NUMBERS, data, rng)
            case 2 | 3:
                data = _replace_one(_TOKEN, WORDS, data, rng)
            case 4:
                lines = data.split(b"\n")
                place = int(rng.integers(len(lines)))
                copies = (0, 2, 2, 40)[int(rng.integers(4))]
                data = b"\n".join(lines[:place] + [lines[place]] * copies + lines[place + 1 :])
            case 5:
                lines = data.split(b"\n")
                one, two = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
                lines[one], lines[two] = lines[two], lines[one]
                data = b"\n".join(lines)
            case _:
                place = int(rng.integers(len(data) + 1))
                opening = (b"[", b"{", b"<a>", b"- ", b"(")[int(rng.integers(5))]
                data = data[:place] + opening * (1, 50, 3000)[int(rng.integers(3))] + data[place:]
    return data


def _replace_one(pattern, choices, data, rng):
    found = list(pattern.finditer(data))
    if not found:
        return data
    hit = found[int(rng.integers(len(found)))]
    return data[: hit.start()] + choices[int(rng.integers(len(choices)))] + data[hit.end() :]


def _inside_archive(data, rng):
    """Mutate one member, or a member's name, and pack the archive again."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # noqa: BLE001 - damaged already; the library raises a dozen kinds.
        return mutate_bytes(data, rng)
    # Texts and indices are a few kilobytes among tensors: mutate them as often as those.
    place = int(rng.integers(len(members)))
    name, content = members[place]
    match int(rng.integers(8)):
        case 0:
            other = members[int(rng.integers(len(members)))][0]
            names = (
                name.upper(), name.swapcase(), f"x/{name}", f"../{name}", f"/{name}", f"{name}x",
                name.replace("/", "\\"), other,
            )  # fmt: skip
            members[place] = (names[int(rng.integers(len(names)))], content)
        case 1:
            del members[place]
        case 2:
            members.append((f"extra/{int(rng.integers(9))}", b"x" * int(rng.integers(5000))))
        case _:
            members[place] = (name, mutate(content, rng) if content else b"\0")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name.replace("\0", "") or "x"), content)
    return packed.getvalue()


def _is_text(data):
    head = data[:2000]
    return bool(head) and sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in head) > 0.97 * len(
        head
    )


def _inside_onnx(data, rng):
    """Change fields of the message somewhere in its tree, and write it again."""
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.ModelProto.FromString(data)
    except DecodeError:
        return mutate_bytes(data, rng)
    for _ in range(int(rng.integers(1, 4))):
        message = model
        while True:
            held = [item for field, value in message.ListFields() if field.message_type
                    for item in (value if field.is_repeated else [value])]  # fmt: skip
            if not held or rng.random() < 0.15:
                break
            message = held[int(rng.integers(len(held)))]
        _change_field(message, rng)
    return model.SerializeToString()


def _change_field(message, rng):
    fields = message.DESCRIPTOR.fields
    field = fields[int(rng.integers(len(fields)))]
    values = {
        "int": (0, -1, 1, 2, 7, 2**31 - 1, 2**40, -(2**63), 16, 3),
        "float": (0.0, -1.0, 1e30, float("nan"), float("inf")),
        "bytes": (b"", b"\0" * 8, b"\xff" * 48, b"../x", b"x" * 5000),
        "str": ("", "obs", "w", "action", "h_in", "Loop", "If", "MatMul", "a/../../b", "x" * 5000,
                "com.evil", "\x1b[2J", "::error::x", "location", "ConstantOfShape", "Identity"),
    }  # fmt: skip
    kind = {9: "str", 12: "bytes", 1: "float", 2: "float"}.get(field.type, "int")
    if field.message_type is not None:
        if field.is_repeated and (held := getattr(message, field.name)):
            one = held[int(rng.integers(len(held)))]
            if rng.random() < 0.5:
                held.add().CopyFrom(one)
            else:
                held.remove(one)
        elif rng.random() < 0.5:
            message.ClearField(field.name)
        return
    value = values[kind][int(rng.integers(len(values[kind])))]
    with contextlib.suppress(ValueError, TypeError):  # An int of 32 bits, an unknown enum.
        if field.is_repeated:
            getattr(message, field.name).append(value)
        else:
            setattr(message, field.name, value)


def _inside_log(data, rng):
    """Mutate one record's content and write the log again, with checksums that are right."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    packed = io.BytesIO()
    try:
        reader = make_reader(io.BytesIO(data))
        summary = reader.get_summary()
        messages = list(reader.iter_messages())
        texts = list(reader.iter_metadata())
    except Exception:  # noqa: BLE001 - damaged already; the library raises a dozen kinds.
        return mutate_bytes(data, rng)
    hit = int(rng.integers(3))
    writer = Writer(packed, chunk_size=2**16)
    writer.start()
    schemas, channels = {}, {}
    for key, schema in summary.schemas.items():
        body = mutate(schema.data, rng) if hit == 0 and rng.random() < 0.2 else schema.data
        schemas[key] = writer.register_schema(schema.name, schema.encoding, body)
    for key, channel in summary.channels.items():
        channels[key] = writer.register_channel(
            channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0)
        )
    chosen = int(rng.integers(max(len(messages), 1)))
    for number, (_, channel, message) in enumerate(messages):
        body = mutate_bytes(message.data, rng) if hit == 1 and number == chosen else message.data
        writer.add_message(channels[channel.id], message.log_time, body, message.publish_time)
    for record in texts:
        told = dict(record.metadata)
        if hit == 2 and told:
            key = sorted(told)[int(rng.integers(len(told)))]
            told[key] = mutate_text(told[key].encode() or b"x", rng).decode(errors="replace")
        writer.add_metadata(record.name, told)
    writer.finish()
    return packed.getvalue()
