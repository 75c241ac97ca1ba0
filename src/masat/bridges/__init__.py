"""Bridges to other packages: one module for each, loaded only when it is imported.

A bridge converts graphs both ways without loss, or says what the other package cannot hold. What
takes part in chi2 is never left out silently: a graph with such parts is refused, with what to do
in the message. Stamps and labels that the other package has no field for are left out with a
`MasatWarning`.
"""
