"""The paper's estimators and tables, beside those that are printed."""
