"""Public names of a package, imported when first used: what needs no JAX does not wait for it."""


def attach(package: str, file: str):
    """`__getattr__` and `__dir__` of a package, of what the `__init__.pyi` beside its file lists.

    Of a name that stands elsewhere in riecjax, the error says where.
    """
    stub = []

    def attached():
        if not stub:
            import lazy_loader

            stub[:] = lazy_loader.attach_stub(package, file)
        return stub

    def __getattr__(name: str):
        public, _, listed = attached()
        if name == "__all__":
            return listed
        try:
            return public(name)
        except AttributeError as error:
            # The lists are read, so that nothing is imported for it.
            from pathlib import Path

            root = Path(__file__).parent
            for beside in sorted(root.rglob("__init__.pyi")):
                if f" as {name}\n" in beside.read_text(encoding="utf-8"):
                    place = ".".join(("rx", *beside.parent.relative_to(root).parts, name))
                    raise AttributeError(f"{package} has no '{name}': write {place}.") from None
            raise error

    return __getattr__, lambda: attached()[1]()
