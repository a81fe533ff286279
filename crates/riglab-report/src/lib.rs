//! Reports: tables, charts and pictures in one self-contained page.
