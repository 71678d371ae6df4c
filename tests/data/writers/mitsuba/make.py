"""Mitsuba's own Cornell box as Mitsuba writes it: .venv-exports/bin/python tests/data/writers/mitsuba/make.py"""

from pathlib import Path

import mitsuba as mi


def main():
    mi.set_variant("scalar_rgb")
    state = mi.parser.parse_dict(mi.parser.ParserConfig("scalar_rgb"), mi.cornell_box())
    mi.parser.write_file(state, str(Path(__file__).with_name("cornell_box.xml")))


if __name__ == "__main__":
    main()
