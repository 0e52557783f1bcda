"""The paper's estimators and tables, compared with the printed ones."""
