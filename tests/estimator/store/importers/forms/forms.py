"""All forms: those of text, and those that a library writes."""

from __future__ import annotations

import datetime
import io
from pathlib import Path

import numpy as np

from tests.estimator.store.importers.forms import written as w
from tests.estimator.store.importers.forms.column_forms import OF_COLUMNS, OF_HEADINGS
from tests.estimator.store.importers.forms.real_forms import DECLARED, REAL
from tests.estimator.store.importers.forms.text_forms import OF_CELLS, OF_REPORTS, OF_TEXT
from tests.estimator.store.importers.forms.written import HEADER, TABLE, Form, saved, workbook

LAB = w.LAB.split(",")
OLD_WORKBOOK = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600
IN_KEYS = dict(zip(HEADER, TABLE.T, strict=True))


def of_libraries(folder: Path) -> list[Form]:
    """Forms that libraries write; those whose library is missing are left out."""
    import h5py
    import scipy.io

    def hdf5(path: Path) -> None:
        with h5py.File(path, "w") as file:
            group = file.create_group("run 1")
            for name, unit in (("time", "s"), ("current", "A")):
                group[name] = IN_KEYS["t_s" if name == "time" else "coil1_current_A"]
                group[name].attrs["unit"] = unit
            group["position"], group["field"] = TABLE[:, 2:5], TABLE[:, 5:]
            group["position"].attrs["units"], group["field"].attrs["units"] = "mm", "uT"

    npz = io.BytesIO()
    np.savez(npz, **IN_KEYS)
    day = datetime.datetime(2026, 3, 1, 12, 0, 0)
    sheet = [LAB, *w.IN_G.tolist()]
    dated = [
        ["Run 7"],
        [],
        ["Time", *LAB[1:]],
        *([day + datetime.timedelta(seconds=row[0]), *row[1:]] for row in w.IN_G.tolist()),
    ]
    forms = [
        Form("arrays.h5", saved(hdf5, folder, "arrays.h5")),
        Form("arrays.mat", saved(lambda path: scipy.io.savemat(path, IN_KEYS), folder, "arrays.mat")),
        Form("arrays.npz", npz.getvalue()),
        Form("old.xls", OLD_WORKBOOK, False, answer=w.PLAIN, tells="save it as .xlsx or CSV"),
        Form("packed.csv.gz", w.COMPRESSED, False, answer=w.PLAIN, tells="unpack it with gunzip"),
        Form("workbook.xlsx", workbook({"Notes": [["nothing", "here"]], "Data": sheet})),
        Form("workbook_with_dates.xlsx", workbook({"Data": dated}), expected=w.with_times(43200.0 + w.T)),
    ]
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return [form for form in forms if form.content]
    frame = pyarrow.table(dict(zip(LAB, w.IN_G.T, strict=True)))
    parquet = saved(lambda path: pyarrow.parquet.write_table(frame, path), folder, "frame.parquet")
    return [form for form in [*forms, Form("frame.parquet", parquet)] if form.content]


TEXTS = [*OF_REPORTS, *OF_TEXT, *OF_CELLS, *OF_COLUMNS, *OF_HEADINGS, *REAL, *DECLARED]
