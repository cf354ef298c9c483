"""Pickles from elsewhere: plain data come back as pickled, and nothing that one names is ever run."""

from __future__ import annotations

import io
import os
import pickle
import sys
import types

import numpy as np
import pytest
import scipy.sparse
from hypothesis import example, given, settings
from hypothesis import strategies as st

from grabnet.errors import UserError
from grabnet.io import pickles, unpickling
from grabnet.io.pickles import decode_pickle, read_pickle

PLAIN = {
    "text": "mäuse",
    "bytes": b"\x00\xff",
    "numbers": [1, -(2**70), 1.5, True, None],
    "empty": b"",
    "nested": ({"a": {1, 2}}, frozenset({3}), (), [[]]),
    4: (5, 6),
}
ARRAYS = {
    "float": np.linspace(0, 1, 12).reshape(3, 4),
    "fortran": np.asfortranarray(np.arange(6, dtype=np.int16).reshape(2, 3)),
    "big endian": np.arange(5, dtype=">f4"),
    "bool": np.array([True, False]),
    "text": np.array(["mug", "wineglass"]),
    "bytes": np.array([b"ab", b"c"]),
    "complex": np.array([1 + 2j]),
    "empty": np.zeros((0, 3), np.float32),
    "single": np.array(3.0),
    "scalar": np.float32(1.25),
    "text scalar": np.str_("s4"),
}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_come_back(protocol):
    assert decode_pickle(pickle.dumps(PLAIN, protocol), "file") == PLAIN


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_come_back(name, protocol):
    array = ARRAYS[name]
    decoded = decode_pickle(pickle.dumps({"x": array}, protocol), "file")["x"]
    assert type(decoded) is type(array)
    assert decoded.dtype == array.dtype.newbyteorder("=")
    np.testing.assert_array_equal(decoded, array)


def test_arrays_of_objects_are_decoded_inside():
    array = np.empty((1, 2), object)
    array[0, 0], array[0, 1] = {"transl": np.ones((4, 3))}, "mug"
    decoded = decode_pickle(pickle.dumps(array), "file")
    assert decoded.shape == (1, 2) and decoded[0, 1] == "mug"
    np.testing.assert_array_equal(decoded[0, 0]["transl"], np.ones((4, 3)))


def test_an_array_as_python_2_wrote_it():
    values = np.array([1.5, -2.0, 1e300])
    data = values.astype("<f8").tobytes()
    written = (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x03\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
        b"\x89T" + len(data).to_bytes(4, "little") + data + b"tb."
    )
    np.testing.assert_array_equal(decode_pickle(written, "file"), values)


@pytest.fixture
def chumpy(monkeypatch):
    """Classes of the names that chumpy's have, with its attributes, for writing; they are gone before reading."""
    made = {}
    for module, name in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select"), ("chumpy.reordering", "Reshape")):
        made[name] = type(name, (), {"__module__": module, "__init__": lambda self, **kw: self.__dict__.update(kw)})
        monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
        monkeypatch.setitem(sys.modules, module, sys.modules.get(module) or types.ModuleType(module))
        setattr(sys.modules[module], name, made[name])

    def write(value, protocol):
        data = pickle.dumps(value, protocol)
        for module in ("chumpy", "chumpy.ch", "chumpy.reordering"):
            monkeypatch.delitem(sys.modules, module)
        return data

    return types.SimpleNamespace(write=write, **made)


@pytest.mark.parametrize("protocol", [0, 1, 2, 4])
def test_chumpy_arrays_become_plain_ones(chumpy, protocol):
    x = np.random.default_rng(0).normal(size=(5, 3, 10))
    chosen = np.arange(5 * 3 * 4)[::-1].copy()
    whole = chumpy.Ch(x=x, _dirty_vars=set(), _itr=None)
    value = {
        "shapedirs": whole,
        "some": chumpy.Select(a=whole, idxs=chosen, preferred_shape=(5, 3, 4)),
        "flat": chumpy.Reshape(a=chumpy.Select(a=whole, idxs=chosen), newshape=(-1, 6)),
    }
    decoded = decode_pickle(chumpy.write(value, protocol), "file")
    assert "chumpy" not in sys.modules
    np.testing.assert_array_equal(decoded["shapedirs"], x)
    np.testing.assert_array_equal(decoded["some"], x.ravel()[chosen].reshape(5, 3, 4))
    np.testing.assert_array_equal(decoded["flat"], x.ravel()[chosen].reshape(-1, 6))


def test_arrays_of_no_bytes_and_many_rows_are_refused_however_they_are_shaped(chumpy):
    none, shape = np.zeros(0), (10**12, 0)
    matrix = scipy.sparse.csc_matrix((0, 0))
    matrix._shape = shape
    values = [chumpy.Reshape(a=none, newshape=shape), matrix]
    values += [chumpy.Select(a=none, idxs=np.zeros(0, int), preferred_shape=shape)]
    written = [pickle.dumps(value) for value in values]
    chumpy.write(None, 2)
    for data in written:
        with pytest.raises(UserError, match="an array of 1000000000000×0 values"):
            decode_pickle(data, "file")


@pytest.mark.parametrize("protocol", [0, 2, 5])
@pytest.mark.parametrize("kind", ["csc", "csr"])
def test_sparse_matrices_become_dense(kind, protocol):
    matrix = scipy.sparse.random(16, 50, 0.1, kind, random_state=0)
    written = pickle.dumps(matrix, protocol)
    # The module had another name when the published files were written.
    older = pickle.dumps(matrix, 0).replace(f"scipy.sparse._{kind}".encode(), f"scipy.sparse.{kind}".encode())
    for data in (written, older):
        np.testing.assert_array_equal(decode_pickle(data, "file"), matrix.toarray())


class Run:
    def __init__(self, function, *arguments):
        self.made = function, arguments

    def __reduce__(self):
        return self.made


def _global(module: str, name: str) -> bytes:
    return f"c{module}\n{name}\n".encode()


_TOUCH = b"(S'touch crater'\ntR."
_WRITE = "open('crater', 'w')"


def _call(function: bytes, *arguments: bytes) -> bytes:
    return function + b"(" + b"".join(arguments) + b"tR"


def _text(text: str) -> bytes:
    """As protocol 4 writes it."""
    return b"\x8c" + bytes([len(text)]) + text.encode()


# A dtype of one object, whose forged flags claim that it holds plain bytes: numpy would take them for a pointer.
_OBJECT = _call(_global("numpy", "dtype"), b"S'O8'\n", b"I0\n", b"I1\n")
_POINTER = (
    _call(_global("numpy", "dtype"), b"S'V8'\n", b"I0\n", b"I1\n")
    + b"(I3\nS'|'\nN(S'a'\nt(S'a'\n("
    + _OBJECT
    + b"I0\ntdI8\nI1\nI0\ntb"
)
_FORGED = (
    _call(_global("numpy.core.multiarray", "_reconstruct"), _global("numpy", "ndarray"), b"(I0\nt", b"S'b'\n")
    + b"(I1\n(I1\nt" + _POINTER + b"I00\nS'AAAAAAAA'\ntb."
)  # fmt: skip
ATTACKS = {
    "os.system": _global("os", "system") + _TOUCH,
    "posix.system": _global("posix", "system") + _TOUCH,
    "subprocess.Popen": _global("subprocess", "Popen") + _TOUCH,
    "instance": b"(S'touch crater'\nios\nsystem\n.",
    "object": b"(cos\nsystem\nS'touch crater'\no.",
    "stack global": b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x0ctouch crater\x85R.",
    "builtins.eval": pickle.dumps(Run(eval, _WRITE)),
    "builtins.exec": pickle.dumps(Run(exec, _WRITE)),
    "python 2's eval": _global("__builtin__", "eval") + f'(S"{_WRITE}"\ntR.'.encode(),
    "builtins.getattr": pickle.dumps(Run(getattr, Run(__import__, "os"), "mkdir")),
    "dotted name": b"\x80\x04" + _text("numpy") + _text("ndarray.__init__.__class__") + b"\x93.",
    "dotted module": b"\x80\x04" + _text("builtins") + _text("object.__subclasses__") + b"\x93)R.",
    "operator": pickle.dumps(Run(__import__("operator").attrgetter, "system")),
    "functools.partial": pickle.dumps(Run(__import__("functools").partial, eval, _WRITE)),
    "numpy.load": _global("numpy", "load") + b"(S'crater.npy'\nNI01\ntR.",
    "numpy.save": _global("numpy", "save") + b"(S'crater.npy'\nI1\ntR.",
    "numpy memmap": _global("numpy", "memmap") + b"(S'crater'\nS'u1'\nS'w+'\nI0\nI8\ntR.",
    "numpy.lib.npyio": _global("numpy.lib.npyio", "DataSource") + b"(S'crater'\ntR.",
    "numpy runstring": _global("numpy.testing._private.utils", "runstring") + f'(S"{_WRITE}"\n}}tR.'.encode(),
    "numpy load_library": _global("numpy.ctypeslib", "load_library") + b"(S'crater.so'\nS'.'\ntR.",
    "numpy fromfile": _global("numpy.core.multiarray", "fromfile") + b"(S'/etc/hostname'\ntR.",
    "subclass of array": _global("numpy.core.multiarray", "_reconstruct") + _global("numpy", "memmap") + _TOUCH,
    "reconstructor": _global("copyreg", "_reconstructor") + _global("os", "system") + _TOUCH,
    "weird codec": _global("_codecs", "encode") + b"(Vtouch\nVrot13\ntR.",
    "forged array": _FORGED,
    "persistent id": b"Pcrater\n.",
    "extension registry": b"\x82\x01.",
    "changes a stand-in": _global("chumpy.ch", "Ch") + b"(N(dS'__new__'\nN" + b"stb.",
    "changes a class's method": _global("chumpy.ch", "Ch") + b"(dS'__setstate__'\nNsb.",
}  # fmt: skip


@pytest.mark.parametrize("name", ATTACKS)
def test_attacks_are_refused_and_run_nothing(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stands_for = {k: dict(vars(v)) for k, v in unpickling.STANDS_FOR.items()}
    for data in (ATTACKS[name], ATTACKS[name][:-1] + b"0}."):  # also where its result is thrown away
        with pytest.raises(UserError) as error:
            decode_pickle(data, "model.pkl")
        assert str(error.value).startswith("model.pkl ") and str(error.value).endswith(".")
        assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
    assert stands_for == {k: dict(vars(v)) for k, v in unpickling.STANDS_FOR.items()}


@pytest.mark.parametrize("name", ["os.system", "builtins.eval", "numpy.load"])
def test_the_refused_class_is_named(name):
    with pytest.raises(UserError, match=rf"model\.pkl holds a pickled {name}"):
        decode_pickle(ATTACKS[name], "model.pkl")


def test_the_attacks_would_work_otherwise(tmp_path, monkeypatch):
    """With the usual reader they do what they say: else the tests above would prove nothing."""
    monkeypatch.chdir(tmp_path)
    for name in ("os.system", "stack global", "builtins.exec", "object", "instance", "numpy memmap"):
        pickle.load(io.BytesIO(ATTACKS[name]))  # noqa: S301
        assert (tmp_path / "crater").exists(), name
        (tmp_path / "crater").unlink()


class Naming(pickle.Unpickler):
    """The usual reader, but for what a pickle names: that is only noted."""

    def __init__(self, data: bytes):
        super().__init__(io.BytesIO(data), encoding="latin1")
        self.named = []

    def find_class(self, module, name):
        self.named.append(f"{module}.{name}")
        return type("Named", (), {"__init__": lambda self, *arguments: None, "__setstate__": lambda self, state: None})


@pytest.mark.parametrize("name", [name for name in ATTACKS if "changes" not in name])
def test_the_attacks_are_well_formed(name):
    """The usual reader gets through each: what is refused is what it names, not how it is written."""
    reader = Naming(ATTACKS[name])
    try:
        reader.load()
    except (pickle.UnpicklingError, ValueError) as error:
        assert "persistent" in str(error) or "extension" in str(error)  # of those two attacks
        return
    assert reader.named


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("forged array", "numpy array of type V8"),
        ("dotted name", r"numpy\.ndarray\.__init__\.__class__"),
        ("dotted module", r"builtins\.object\.__subclasses__"),
        ("subclass of array", r"numpy\.memmap"),
        ("weird codec", "text in rot13"),
    ],
)
def test_an_attack_is_refused_for_what_it_is(name, sentence):
    with pytest.raises(UserError, match=f"holds a pickled {sentence}"):
        decode_pickle(ATTACKS[name], "model.pkl")


def test_what_holds_itself_is_refused():
    endless: list = []
    endless.append(endless)
    with pytest.raises(UserError, match="holds itself"):
        decode_pickle(pickle.dumps(endless), "file")


def _doubled(pairs: bytes, times: int) -> bytes:
    """A value of twice the last one's parts, again and again: instructions to keep, to take it twice, and to join."""
    return b"".join(b"q" + bytes([k]) + b"h" + bytes([k]) + pairs for k in range(times))


def _shared_list(times: int) -> list:
    value = [1.0]
    for _ in range(times):
        value = [value, value]
    return value


def _equal_frozensets(times: int, make: bytes) -> bytes:
    """Two values of their own making that are equal, in one set; each part is compared as often as it is named."""

    def chain(memo: bytes) -> bytes:
        one, two = (b"h" + memo + b"K" + bytes([k]) + b"\x86" for k in range(2))
        return make % b"K\x01" + b"q" + memo + (b"0" + make % (one + two) + b"q" + memo) * times

    return b"\x80\x04" + chain(b"\x00") + b"0" + chain(b"\x01") + b"0\x8f(h\x00h\x01\x90."


# What a reader that follows each reference never ends with, or breaks Python: small pickles of much work.
ENDLESS = {
    "tuples as a key": b"\x80\x02})" + _doubled(b"\x86", 90) + b"Ns.",
    "tuples in a set": b"\x80\x04\x8f()" + _doubled(b"\x86", 90) + b"\x90.",
    "tuples in a frozenset": b"\x80\x04()" + _doubled(b"\x86", 90) + b"\x91.",
    "frozensets that are equal": _equal_frozensets(60, b"(%s\x91"),
    "frozensets that are called for": _equal_frozensets(60, b"cbuiltins\nfrozenset\n(%sl\x85R"),
    "tuples that say they are small": b"\x80\x02})" + _doubled(b"\x86}X\x05\0\0\0partsK\x00sb", 90) + b"Ns.",
    "tuples that are shared": b"\x80\x02)" + _doubled(b"\x86", 90) + b".",
    "lists that are shared": pickle.dumps(_shared_list(200)),
    "dicts that are shared": b"\x80\x02]" + b"".join(b"q%c}(K\x00h%cK\x01h%cu" % (k, k, k) for k in range(90)) + b".",
    "arrays that are shared": pickle.dumps([_shared_list(22)]),
    "nested lists": b"]" * 100_000 + b"a" * 99_999 + b".",
    "nested tuples": b")" + b"\x85" * 200_000 + b".",
    "nested tuples as a key": b"})" + b"\x85" * 200_000 + b"Ns.",
    "nested dicts": b"}K\x00" * 50_000 + b"N" + b"s" * 50_000 + b".",
    "calls of one list": b"\x80\x02](" + b"K\x01" * 90_000 + b"eq\x00" + b"cbuiltins\nset\nh\x00\x85R0" * 9000 + b".",
    "codes of one text": b"\x80\x02X\xa0\x86\x01\x00" + b"a" * 100_000 + b"q\x00X\x06\x00\x00\x00latin1q\x01"
    + b"c_codecs\nencode\nh\x00h\x01\x86R" * 3000 + b".",
    "a bytearray of 2**40 bytes": b"\x80\x05\x96" + (2**40).to_bytes(8, "little") + b".",
    "a number of a million digits": b"\x80\x02\x8b\xa0\x86\x01\x00" + b"\x7f" * 100_000 + b".",
    "half a character": pickle.dumps("\ud800"),
    "an array of no bytes and 10**12 rows": pickle.dumps(np.zeros((10**12, 0))),
    "a dtype that numpy would evaluate": _call(_global("numpy", "dtype"), b"S'" + b"(" * 5000 + b"f4'\n") + b".",
}  # fmt: skip


@pytest.mark.parametrize("name", ENDLESS)
def test_small_pickles_of_much_work_are_refused(name):
    with pytest.raises(UserError) as error:
        decode_pickle(ENDLESS[name], "file")
    assert str(error.value).startswith("file ") and len(str(error.value)) < 300


def test_parts_that_are_shared_a_few_times_are_read():
    decoded = decode_pickle(pickle.dumps(_shared_list(10)), "file")
    assert decoded[0] is decoded[1] and decoded == _shared_list(10)


def test_arrays_that_unfold_beyond_the_limit_are_refused(monkeypatch):
    array = np.zeros(1000)
    data = pickle.dumps([array[:] for _ in range(100)])
    monkeypatch.setattr(pickles, "MAX_BYTES", 100 * array.nbytes)
    assert len(decode_pickle(data, "file")) == 100
    for value in ([array[:] for _ in range(101)], scipy.sparse.csc_matrix((10**4, 10**4))):
        with pytest.raises(UserError, match="unfolds to more than"):
            decode_pickle(pickle.dumps(value), "file")


def test_huge_memo_numbers_take_no_memory():
    assert decode_pickle(b"]r\xff\xff\xff\xff.", "file") == []


@pytest.mark.parametrize(
    "change", [{"indices": np.array([0, 99])}, {"indices": np.array([-1, 0])}, {"indptr": np.array([0, 5, 2, 2])}]
)
def test_sparse_entries_outside_the_matrix_are_refused(change):
    matrix = scipy.sparse.csc_matrix(np.diag([1.0, 2.0, 0.0]))
    for name, value in change.items():
        setattr(matrix, name, value)
    with pytest.raises(UserError, match="sparse matrix"):
        decode_pickle(pickle.dumps(matrix), "file")


@settings(deadline=None, max_examples=150)
@given(
    position=st.floats(0, 1, exclude_max=True),
    byte=st.integers(0, 255),
    insert=st.booleans(),
    protocol=st.integers(0, 5),
)
@example(position=0.0, byte=0, insert=False, protocol=2)
def test_any_damage_gives_data_or_a_sentence(position, byte, insert, protocol):
    data = bytearray(pickle.dumps({"x": np.arange(4.0), "y": [np.float32(1), "mug"]}, protocol))
    at = int(position * len(data))
    data[at : at + (not insert)] = bytes([byte])
    try:
        decode_pickle(bytes(data), "file")
    except UserError as error:
        assert str(error).startswith("file ")


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        read_pickle(tmp_path / "model.pkl")
    with pytest.raises(UserError, match="is no regular file"):
        read_pickle(tmp_path)


def test_a_file_is_read(tmp_path):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(PLAIN))
    assert read_pickle(tmp_path / "a.pkl") == PLAIN
    (tmp_path / "b.pkl").write_bytes(pickle.dumps(Run(os.mkdir, str(tmp_path / "crater"))))
    with pytest.raises(UserError, match=r"b\.pkl holds a pickled posix\.mkdir"):
        read_pickle(tmp_path / "b.pkl")
    assert not (tmp_path / "crater").exists()
