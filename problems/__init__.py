"""Problems with known answers: one module each, with ``build()``, ``REFERENCE`` and ``main()``."""
