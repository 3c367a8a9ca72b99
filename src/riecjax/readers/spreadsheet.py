"""Reading spreadsheets of Excel (.xlsx, .xlsm), with the extra `excel`."""

import datetime
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

from riecjax.errors import DataError
from riecjax.records import reading
from riecjax.runtime import require_memory

MEMORY_PER_BYTE = 20.0
"""What reading takes for each byte of a file."""
FILLED = 0.1
"""Share of a column's cells from which it belongs to the table."""
FEWEST_ROWS, FEWEST_COLUMNS = 10, 2
"""Of a sheet that may be a recording, where there are several sheets."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


@reading.apart("Excel", needs="Excel")
def read_spreadsheet(
    file: Path, decimal: str | None = None, columns: Sequence[str] = ()
) -> reading.Channels:
    """Read the sheets of a workbook that hold tables of numbers, each as a text file is read.

    Formulas count as the values that were saved with them, cells of dates and times to the
    millisecond; hidden sheets are left out. Of several such sheets, columns are called
    `Sheet/column`, and each is a part. The library may crash on a damaged file, so it reads in a
    process of its own.

    **Arguments:** `decimal`, of numbers that stand there as text, and names of the `columns`,
    instead of detecting them.

    **Raises:** `DataError` for a damaged file, one that unpacks to too much, one without a table,
    or where python-calamine is not installed; `MemoryError`.
    """
    import python_calamine

    size = MEMORY_PER_BYTE * file.stat().st_size
    require_memory(f"reading {file.name}", size, "Read a part of the file.")
    with zipfile.ZipFile(file) as archive:
        size = sum(member.file_size for member in archive.infolist())
    reading.check_declared(unpacked=size, packed=file.stat().st_size)
    book = python_calamine.load_workbook(str(file))
    worksheet = python_calamine.SheetTypeEnum.WorkSheet
    sheets = [sheet for sheet in book.sheets_metadata if sheet.typ == worksheet]
    shown = [one for one in sheets if one.visible == python_calamine.SheetVisibleEnum.Visible]
    names = [sheet.name for sheet in shown or sheets]
    tables: dict[str, reading.Channels] = {}
    refused: list[str] = []
    for name in names:
        sheet = book.get_sheet_by_name(name)
        reading.check_declared(sheet.width, 8 * sheet.width * sheet.height)
        try:
            text = as_text(sheet.to_python(), decimal)
            # A stroke in a sheet's name would look like a group.
            part = name.replace("/", " ")
            tables[part] = reading.read_table(text.encode(), "\t", ".", columns)
            if not tables[part].columns:
                del tables[part]
                raise DataError("it has no column of numbers.")
        except DataError as error:
            refused.append(f"sheet '{name}': {error}")
    if not tables:
        said = "; ".join(refused) or "there is no sheet."
        raise DataError(f"no sheet holds a table of numbers: {said}")
    # Of several, those that may be recordings.
    large = {
        name: table
        for name, table in tables.items()
        if sum(values.size >= FEWEST_ROWS for values in table.columns.values()) >= FEWEST_COLUMNS
    } or tables
    if len(large) > 1:
        whole = reading.joined(large)
    else:
        ((name, whole),) = large.items()
        whole.notes[:0] = [f"sheet '{name}'"] * (len(tables) + len(refused) > 1)
    hidden = [sheet.name for sheet in sheets if sheet.name not in names]
    whole.notes.extend(f"hidden sheet '{name}' left out" for name in hidden)
    return whole


def as_text(rows: Sequence[Sequence[object]], decimal: str | None = None) -> str:
    """Cells as text delimited by tabs, to the last digit, numbers with a decimal point."""
    margin = 0
    for place, column in enumerate(zip(*rows, strict=True)):
        # Columns left of the table are empty but for a title.
        texts = [cell for cell in column if isinstance(cell, str)]
        if len(texts) < len(column) or sum(map(bool, texts)) > FILLED * len(column):
            margin = place
            break
    lines = ("\t".join(_text(cell, decimal) for cell in row[margin:]) for row in rows)
    return "".join(f"{line}\n" for line in lines)


def _text(cell: object, decimal: str | None) -> str:
    """A cell's number, or its text without what would delimit cells or rows."""
    match cell:
        case bool():
            return str(int(cell))
        case int() | float():
            return repr(cell)
        case datetime.timedelta():
            minutes, seconds = divmod(cell, datetime.timedelta(minutes=1))
            return f"{minutes // 60}:{minutes % 60:02d}:{seconds.total_seconds():09.6f}"
        case datetime.datetime():
            return cell.isoformat(" ")
        case datetime.date():
            return f"{cell.isoformat()} 00:00:00"
        case datetime.time():
            return cell.isoformat()
    text = re.sub(r'[\s"]+', " ", str(cell)).strip()
    return text.replace(",", ".") if decimal != "." and _DECIMAL_COMMA.fullmatch(text) else text
