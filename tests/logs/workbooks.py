"""Small workbooks of Excel and OpenDocument, written as the XML that they are."""

import io
import zipfile
from collections.abc import Mapping

MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"


def zipped(members: dict[str, str]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def cell(value) -> str:
    if isinstance(value, str):
        return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
    return f"<c><v>{value}</v></c>"


def xlsx(sheets: Mapping[str, list | str]) -> bytes:
    """Workbook of Excel; a sheet is a list of rows, or the XML of its rows."""
    numbers = list(enumerate(sheets, 1))
    main = f'<workbook xmlns="{MAIN}" xmlns:r="{OFFICE}"><sheets>'
    main += "".join(f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, name in numbers)
    links = "".join(
        f'<Relationship Id="r{k}" Type="{OFFICE}/worksheet" Target="worksheets/s{k}.xml"/>'
        for k, _ in numbers
    )
    root = f'<Relationship Id="r" Type="{OFFICE}/officeDocument" Target="xl/workbook.xml"/>'
    members = {
        "[Content_Types].xml": f'<Types xmlns="{PACKAGE}/content-types"/>',
        "_rels/.rels": f'<Relationships xmlns="{PACKAGE}/relationships">{root}</Relationships>',
        "xl/workbook.xml": main + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{PACKAGE}/relationships">{links}'
        "</Relationships>",
    }
    for k, name in numbers:
        rows = sheets[name]
        if not isinstance(rows, str):
            rows = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
        sheet = f'<worksheet xmlns="{MAIN}"><sheetData>{rows}</sheetData></worksheet>'
        members[f"xl/worksheets/s{k}.xml"] = sheet
    return zipped(members)


def ods(rows: str) -> bytes:
    names = {"office": "office", "table": "table", "text": "text"}
    spaces = " ".join(
        f'xmlns:{k}="urn:oasis:names:tc:opendocument:xmlns:{v}:1.0"' for k, v in names.items()
    )
    return zipped(
        {
            "mimetype": "application/vnd.oasis.opendocument.spreadsheet",
            "META-INF/manifest.xml": '<manifest:manifest xmlns:manifest="urn:oasis:names:tc:'
            'opendocument:xmlns:manifest:1.0"/>',
            "content.xml": f"<office:document-content {spaces}><office:body><office:spreadsheet>"
            f'<table:table table:name="Data">{rows}</table:table></office:spreadsheet>'
            "</office:body></office:document-content>",
        }
    )


def ods_cell(value, repeated: int = 1) -> str:
    kind = "string" if isinstance(value, str) else "float"
    text = "" if kind == "string" else f' office:value="{value}"'
    many = f' table:number-columns-repeated="{repeated}"' if repeated > 1 else ""
    start = f'<table:table-cell office:value-type="{kind}"{text}{many}>'
    return f"{start}<text:p>{value}</text:p></table:table-cell>"
