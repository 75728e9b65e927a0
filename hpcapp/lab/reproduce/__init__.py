"""The paper's figures and its Table 1, made again."""
