"""Label sets in other tools' formats: one file a format, its writer and its reader beside each other."""
