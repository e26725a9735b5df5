"""Label sets in other tools' formats: one file per format, with its writer and its reader."""
