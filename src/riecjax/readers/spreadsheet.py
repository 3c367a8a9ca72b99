"""Reading spreadsheets of Excel (.xlsx, .xlsm), with the extra `excel`."""

import datetime
import re
import zipfile
from collections.abc import Iterable, Sequence
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
    refused: dict[str, str] = {}
    for name in names:
        sheet = book.get_sheet_by_name(name)
        reading.check_declared(sheet.width, 8 * sheet.width * sheet.height)
        try:
            text = as_text(sheet.to_python(), decimal)
            table = reading.read_table(text.encode(), "\t", decimal, columns)
            if not table.columns:
                raise DataError("it has no column of numbers.")
            tables[name] = table
        except DataError as error:
            refused[name] = str(error)
    if not tables:
        said = "; ".join(f"sheet '{name}': {why}" for name, why in refused.items())
        raise DataError(f"no sheet holds a table of numbers: {said or 'there is no sheet.'}")
    # Of several, those that may be recordings.
    large = {
        name: table
        for name, table in tables.items()
        if sum(values.size >= FEWEST_ROWS for values in table.columns.values()) >= FEWEST_COLUMNS
    } or tables
    if len(large) > 1:
        # A stroke in a sheet's name would look like a group.
        whole = reading.joined({name.replace("/", " "): table for name, table in large.items()})
    else:
        ((name, whole),) = large.items()
        whole.notes[:0] = [f"sheet '{name}'"] * (len(tables) + len(refused) > 1)
    hidden = [sheet.name for sheet in sheets if sheet.name not in names]
    whole.notes.extend(f"hidden sheet '{name}' left out" for name in hidden)
    return whole


def as_text(rows: Iterable[Sequence[object]], decimal: str | None = None) -> str:
    """Cells as text delimited by tabs, to the last digit.

    Where there are numbers with a decimal comma, as text, all numbers get one.
    """
    cells = [[_text(cell) for cell in row] for row in rows]
    texts = (text for row in cells for text in row if isinstance(text, str))
    comma = decimal == "," or (decimal is None and any(map(_DECIMAL_COMMA.fullmatch, texts)))

    def shown(cell: str | float) -> str:
        if isinstance(cell, str):
            return cell
        return repr(cell).replace(".", ",") if comma else repr(cell)

    # Columns left of the table are empty but for a title.
    margin = 0
    for place, column in enumerate(zip(*cells, strict=True)):
        filled = [cell for cell in column if cell != ""]
        if len(filled) > FILLED * len(column) or not all(isinstance(cell, str) for cell in filled):
            margin = place
            break
    return "".join("\t".join(map(shown, row[margin:])) + "\n" for row in cells)


def _text(cell: object) -> str | float:
    """A cell's number, or its text without what would delimit cells or rows."""
    match cell:
        case bool():
            return int(cell)
        case int() | float():
            return cell
        case datetime.timedelta():
            minutes, seconds = divmod(cell, datetime.timedelta(minutes=1))
            return f"{minutes // 60}:{minutes % 60:02d}:{seconds.total_seconds():09.6f}"
        case datetime.datetime():
            return cell.isoformat(" ")
        case datetime.date():
            return f"{cell.isoformat()} 00:00:00"
        case datetime.time():
            return cell.isoformat()
    return re.sub(r'[\s"]+', " ", str(cell)).strip()
