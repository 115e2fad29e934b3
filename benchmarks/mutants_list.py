"""The mutants of `benchmarks.mutants`: lines of the framework that trust rests on, spoilt one at a time."""

from __future__ import annotations

from typing import NamedTuple

G, CACHE, RUN = "exmesh_graph/graph", "exmesh_graph/graph/cache", "exmesh_graph/graph/run"
TESTS = "tests/graph"


class Mutant(NamedTuple):
    """`old`, which stands once in `file`, becomes `new`; a test of `tests` that matches `words` must fail then."""

    group: str
    file: str
    old: str
    new: str
    tests: str
    words: str = ""


def _group(name: str, *rows: tuple[str, ...]) -> list[Mutant]:
    return [Mutant(name, *row) for row in rows]


_KEYS, _STORE, _RUNS = f"{TESTS}/test_graph_keys.py", f"{TESTS}/test_graph_store.py", f"{TESTS}/test_graph_run.py"
_HELD = "exmesh_graph/types/contents.py"
_CODE, _GC = f"{TESTS}/test_graph_fingerprint.py", f"{TESTS}/upkeep/test_upkeep_collect.py"

CORE = _group(
    "core: keys, code, store, leases, checkpoints, gc, runs",
    (f"{CACHE}/keys.py", '"seed": bound.seed,', '"seed": 0,', _RUNS, "tuning_is_a_hit"),
    (f"{CACHE}/keys.py", '"version": bound.definition.version,', '"version": "",', _KEYS, "golden"),
    (f"{CACHE}/keys.py", '"libraries": _versions(bound.definition),', '"libraries": {},', _KEYS, "declared_libraries"),
    (f"{CACHE}/keys.py", '"sources": dict(sorted(sources.items())),', '"sources": {},', _KEYS, "sources_change"),
    (
        f"{CACHE}/keys.py",
        "{port: list(pair) for port, pair in sorted(inputs.items())}",
        "dict(enumerate(sorted(map(list, inputs.values()))))",
        _KEYS,
        "swapped",
    ),
    (f"{CACHE}/keys.py", 'return {"~float": value.hex()}', "return round(value, 6)", _KEYS, "injective or imitated"),
    (
        f"{CACHE}/keys.py",
        '"code": fingerprint(definition).digest,',
        '"code": "",',
        f"{TESTS}/test_graph_components.py",
        "",
    ),
    (f"{CACHE}/fingerprint.py", "                todo += self.module(name).imports\n", "", _CODE, "edits_that_matter"),
    (
        f"{CACHE}/fingerprint.py",
        "names if sources.module(name).is_edited() or sources.outlived(name)]",
        "names if False]",
        _CODE,
        "edit_during",
    ),
    (f"{G}/sealed.py", "    if text[: start + 3] != f'{_SEAL}{digest}\", ':", "    if False:", _STORE, "sealed"),
    (f"{G}/sealed.py", ':{times}"', ':"', _STORE, "source_digests_follow"),
    (f"{CACHE}/store.py", '"data" / name) != expected:', '"data" / name) == "":', _STORE, "flipped_bytes_are_never"),
    (
        f"{CACHE}/store.py",
        'return head if sizes == {name: size for name, (size, _) in head["files"].items()} else None',
        "return head",
        _STORE,
        "broken_object_is_a_miss",
    ),
    (
        f"{CACHE}/keys.py",
        'record.pop("key") != key or key_of(preimage) != key or',
        'not record.pop("key") or',
        _STORE,
        "wrong_name",
    ),
    (
        f"{CACHE}/lease.py",
        "            if age <= self.limit:\n",
        "            if age <= 1e9:\n",
        f"{TESTS}/test_graph_lease.py",
        "without_a_heartbeat",
    ),
    (f"{RUN}/checkpoint.py", 'if record["key"] != key or', "if", f"{TESTS}/test_graph_checkpoint.py", ""),
    (
        f"{RUN}/checkpoint.py",
        "        if files.sha256_file(folder / name) != digest:",
        "        if False:",
        f"{TESTS}/test_graph_checkpoint.py",
        "doubt",
    ),
    (f"{G}/upkeep/collect.py", "held = fixed | _shown(store, runs, result)", "held = fixed", _GC, "only_what_nothing"),
    (f"{G}/upkeep/collect.py", "if (used or item.path in back) and", "if used and", _GC, "new_record_needs"),
    (
        f"{G}/upkeep/collect.py",
        "again = [item for item, aside in records if _used(aside) != item.used or item.name in held]",
        "again: list[Item] = []",
        _GC,
        "in_the_trash",
    ),
    (f"{RUN}/execute.py", "        if mark_of(value) != before[port]:", "        if False:", _RUNS, "in_place"),
    (f"{RUN}/runner.py", "action = None if bound.name in self.force else", "action =", _RUNS, "force_replaces"),
)

_UNSEEN, _HOLES, _GROWTH = (
    f"{TESTS}/test_graph_unseen.py",
    f"{TESTS}/test_graph_holes.py",
    f"{TESTS}/test_graph_growth.py",
)
_CLEAN = f"{TESTS}/test_graph_hermetic.py"

HOLES = _group(
    "holes: code that no name leads to, what crosses nodes, saves, formats, growth",
    (
        f"{CACHE}/moduletext.py",
        "own |= set(syntax.used_by(self.module.tree)) - self.bound - set(dir(builtins))",
        "own |= set()",
        _UNSEEN,
        "such_code",
    ),
    (f"{CACHE}/syntax.py", "ast.MatchAs, ast.MatchStar, ", "", _UNSEEN, "such_code or match_binds"),
    (
        f"{CACHE}/syntax.py",
        "last_of(item.func) in LOADERS and",
        "last_of(item.func) in LOADERS[1:] and",
        _UNSEEN,
        "such_code",
    ),
    (f"{CACHE}/syntax.py", "if len(found) == 1 and", "if", _UNSEEN, "such_code"),
    (
        f"{CACHE}/syntax.py",
        '_OURS.get(".".join([names.get(root, ""), *rest])) in words',
        "(rest or [root])[-1] in words",
        _UNSEEN,
        "such_code",
    ),
    (f"{CACHE}/moduletext.py", "statement.name in built", "False", _UNSEEN, "such_code"),
    (f"{CACHE}/moduletext.py", "*(base + suffix for suffix in _SUFFIXES)", "base + '.py'", _UNSEEN, "compiled"),
    (
        f"{CACHE}/moduletext.py",
        "            return hashlib.sha256(self.data).hexdigest()\n",
        "            return sha(self.name)\n",
        _UNSEEN,
        "compiled",
    ),
    (f"{CACHE}/moduletext.py", "names & own - self.mentioned", "False", _UNSEEN, "such_code"),
    (
        f"{CACHE}/fingerprint.py",
        '*self._siblings(module.partition(".")[0])',
        'module.partition(".")[0]',
        _UNSEEN,
        "second_package",
    ),
    (
        f"{CACHE}/fingerprint.py",
        "if changed or any(source_file(name) for name in absent):",
        "if changed:",
        _UNSEEN,
        "may_be_missing",
    ),
    ("exmesh_graph/api/unseen.py", "if name != own or line in made.lines", "", _UNSEEN, "no_key_holds"),
    ("exmesh_graph/api/reach.py", "if dotted in _BUILTINS:", "if False:", _UNSEEN, "no_key_holds"),
    ("exmesh_graph/api/reach.py", "chain[:-1]):", "()):", _UNSEEN, "no_key_holds"),
    ("exmesh_graph/api/standard.py", "dotted = real(dotted)", "pass", _UNSEEN, "no_key_holds or nobody_thought"),
    (
        "exmesh_graph/api/standard.py",
        "            return dotted\n        if known in _PURE",
        "            return ''\n        if known in _PURE",
        _UNSEEN,
        "no_key_holds",
    ),
    (
        "exmesh_graph/api/fixed.py",
        "item.id in self._imported or item.id in self._defined",
        "False",
        _UNSEEN,
        "no_key_holds",
    ),
    ("exmesh_graph/api/unseen.py", "if full in lent)", "if False)", _UNSEEN, "others_lend"),
    (f"{RUN}/hermetic.py", "            time.tzset()\n", "", _CLEAN, "behind"),
    (f"{RUN}/hermetic.py", "        locale.setlocale(locale.LC_ALL, words)\n", "", _CLEAN, "locale"),
    (f"{RUN}/hermetic.py", '    ("torch", "is_grad_enabled", "set_grad_enabled", True),\n', "", _CLEAN, ""),
    (f"{RUN}/hermetic.py", "with decimal.localcontext():", "with contextlib.nullcontext():", _CLEAN, "behind"),
    (
        f"{RUN}/execute.py",
        "if again is None or lost:",
        "if again is None:",
        _HOLES,
        "save_that_loses",
    ),
    (f"{RUN}/execute.py", "job.type, job.key, job.seed", "job.name, job.key, job.seed", _HOLES, "name_in_the_graph"),
    (f"{G}/language/nodecheck.py", "not math.isfinite(item)", "item != item", _HOLES, "numbers_that_are_none"),
    (f"{CACHE}/store.py", "if found != FORMAT and not whatever:", "if False:", _HOLES, "another_version"),
    (
        f"{G}/language/extends.py",
        "{path.suffix, os.path.splitext(os.path.realpath(path))[1]}",
        "{path.suffix}",
        _HOLES,
        "no_graphs",
    ),
    (
        f"{G}/language/links.py",
        "            self.reached[key] = max(self.reached.get(key, 0), done)\n",
        "            pass\n",
        _GROWTH,
        "checked_at_once",
    ),
    ("exmesh_graph/files.py", "else 512 * own.st_blocks", "else own.st_size", _GROWTH, "sizes_are"),
    (f"{RUN}/backends/worker.py", "if path.stat().st_size > LOG_BYTES:", "if False:", _GROWTH, "talks"),
    ("exmesh_graph/report/collect.py", "bits & ~ancestors[name]", "bits", _GROWTH, "all_ancestors"),
)

_LIMITS, _MAYBE = f"{TESTS}/test_graph_limits.py", f"{TESTS}/test_graph_conditions.py"
_REMOTE, _ENV = f"{TESTS}/test_graph_remote.py", f"{TESTS}/test_graph_environment.py"
_INSIDE = f"{TESTS}/variants/test_variants_patches_inside.py"
_FROM, _SHARED = "tests/api/test_api_provenance.py", "tests/api/test_api_sharing.py"
_TRIED = "waited_for and own"

REACH = _group(
    "reach: limits, conditions, shared stores, patches, environment, provenance",
    (
        f"{RUN}/backends/local.py",
        "if took > job.limits.get(name, math.inf)",
        "if took > 1e9",
        _LIMITS,
        "past_its_limit and not megabytes and not disk",
    ),
    (f"{RUN}/backends/local.py", 'if fitting and "ram_gb" not in job.limits:', "if fitting:", _LIMITS, "within"),
    (
        f"{RUN}/backends/local.py",
        "            self._drop(worker)\n        worker.job = None",
        "        worker.job = None",
        _LIMITS,
        "within",
    ),
    (f"{RUN}/backends/local.py", 'taken["disk_gb"] = sum(', 'taken["disk_gb"] = 0 * sum(', _LIMITS, "disk"),
    ("exmesh_graph/resources.py", "process.children(recursive=True)", "()", _LIMITS, "is_measured"),
    ("exmesh_graph/errors.py", "        seen = seen.__cause__\n", "        seen = None\n", _LIMITS, "what_may_pass"),
    (
        f"{RUN}/runner.py",
        'self.tries[name] < job.limits.get("retries", 0)',
        'self.tries[name] <= job.limits.get("retries", 0)',
        _LIMITS,
        "others_are_not",
    ),
    (
        f"{RUN}/runner.py",
        "if key in keys or self.later.get(name, 0.0) > time.monotonic():",
        "if key in keys:",
        _LIMITS,
        _TRIED,
    ),
    (f"{RUN}/job.py", "limits=bound.limits,", "", _LIMITS, _TRIED),
    (f"{RUN}/lists.py", "if wired and not any(there) and", "if wired and not all(there) and", _MAYBE, "gaps"),
    (f"{RUN}/lists.py", "(not port.optional or name in bound.each)", "True", _MAYBE, "switches_its_users_off"),
    (f"{RUN}/runner.py", "not in (DONE, HIT, IDLE)]", "not in (DONE, HIT)]", _MAYBE, "switches_its_users_off and 0"),
    (f"{CACHE}/remote.py", "min(_BLOCK, size + 1 - file.tell())", "_BLOCK", _REMOTE, "longer_than"),
    (f"{CACHE}/remote.py", '> self.limits["gb"] * 1e9', "> 1e30", _REMOTE, "left_there and memory"),
    (f"{CACHE}/remote.py", '.get(self.limits["seconds"])', ".get(30)", _REMOTE, "hangs"),
    (f"{CACHE}/remote.py", "& {*_REFUSED}", "& set()", _REMOTE, "mirror"),
    ("exmesh_graph/api/sharing.py", '"store": str(opened.root)}', "}", _SHARED, "brought_to"),
    ("exmesh_graph/api/sharing.py", 'if told["id"] != run or not', "if not", _SHARED, "was_changed"),
    (f"{G}/language/links.py", "if node in self.passed:", "if False:", _INSIDE, "bypass_in_one"),
    (f"{G}/language/expand.py", '{"bypass", "every", "at"}', '{"bypass"}', _INSIDE, "one_round"),
    (f"{G}/language/params.py", "not str(value).startswith(ENV)", "False", _ENV, "not_meant"),
    (f"{G}/variants/values.py", 'params[text].pop("env", None)', "pass", _ENV, "patch_counts"),
    (
        f"{G}/variants/draft.py",
        "for path in parts if within(text, path)",
        "for path in parts",
        _INSIDE,
        "one_round_of_a_block",
    ),
    (f"{G}/upkeep/collect.py", "if sweeper.returncode is None:", "if False:", _GC, "process_of_their_own"),
    (
        "exmesh_graph/export/stamp.py",
        """and "customLayerData" not in text.partition("\\n)")[0]""",
        "",
        _FROM,
        "published_usd",
    ),
    (
        "exmesh_graph/api/provenance.py",
        "words = [_last_of(word) for word in",
        "words = [word for word in",
        _FROM,
        "nothing_public",
    ),
)

_LESSONS, _BACKEND = f"{TESTS}/test_graph_lessons.py", f"{TESTS}/backends/test_backend_local.py"

LESSONS = _group(
    "lessons: how caches of others lied, and the first holes, once more",
    (f"{CACHE}/keys.py", "bound.signature.path_fields | bound", "bound", _KEYS, "paths_stay_out"),
    (f"{CACHE}/keys.py", "| bound.signature.tuning_fields()", "| set()", _KEYS, "tuning_name"),
    (f"{CACHE}/keys.py", "if name not in tuning}", "}", f"{TESTS}/test_graph_components.py", ""),
    (f"{CACHE}/keys.py", '"epoch": EPOCH,', '"epoch": 0,', _LESSONS, "epoch"),
    (f"{CACHE}/keys.py", '["exmesh.artifact", type_name, rows]', '["exmesh.artifact", rows]', _KEYS, "golden"),
    (
        f"{CACHE}/keys.py",
        "[[name, size, digest] for name, (size, digest) in sorted(table.items())]",
        "[[name, size] for name, (size, digest) in sorted(table.items())]",
        _LESSONS,
        "deep_differences or shape_and_type",
    ),
    (f"{CACHE}/keys.py", '("~" + key if key.startswith("~") else key)', "key", _KEYS, "injective or imitated"),
    (
        f"{CACHE}/keys.py",
        '    raise GraphError(\n        f"a {type(value)',
        '    return repr(value)\n    raise GraphError(\n        f"a {type(value)',
        _KEYS,
        "unknown_types",
    ),
    (
        f"{CACHE}/store.py",
        "            path.chmod(0o444)\n            files",
        "            files",
        _LESSONS,
        "change_in_place",
    ),
    (
        f"{CACHE}/store.py",
        "if target.exists() and not self.holds(digest):",
        "if False:",
        _STORE,
        "replaced_by_the_next_put",
    ),
    (
        f"{CACHE}/store.py",
        "            if not self.holds(digest):\n                self.quarantine",
        "            if False:\n                self.quarantine",
        _STORE,
        "broken_object_is_a_miss",
    ),
    (f"{G}/upkeep/collect.py", "if not needed[digest] and", "if", _GC, "two_records"),
    (f"{G}/upkeep/collect.py", "pinned | leased\n", "pinned\n", _GC, "leased_keys"),
    (f"{CACHE}/moduletext.py", "            cache.unlink()\n", "            pass\n", _CODE, "bytecode"),
    (f"{CACHE}/lease.py", "if text != before:", "if True:", f"{TESTS}/test_graph_lease.py", "without_a_heartbeat"),
    (
        _HELD,
        "return [part for pair in item.items() for part in pair]",
        "return []",
        _RUNS,
        "dicts_of_inputs or marks_see",
    ),
    (_HELD, "        return list(item)\n", "        return []\n", _RUNS, "marks_see"),
    (_HELD, "yield tuple(sorted(map(repr, item)))", 'yield "set"', _RUNS, "marks_see"),
    (_HELD, ' | getattr(item, "__dict__", {})', "", _RUNS, "marks_see"),
    (
        f"{RUN}/runner.py",
        "        elif outcome.state == STOPPED:\n",
        "        elif False:\n",
        _BACKEND,
        "nobody_asked_for",
    ),
    (f"{RUN}/hermetic.py", "            os.environ.update(environment)\n", "", _CLEAN, "behind"),
    (f"{RUN}/hermetic.py", "            os.chdir(folder)\n", "            pass\n", _CLEAN, "behind"),
    (f"{RUN}/hermetic.py", "    random.seed(seed)\n    for", "    for", _CLEAN, "generators"),
    (f"{RUN}/hermetic.py", '("numpy", "torch"))):', '("numpy",))):', _CLEAN, "generators_start"),
    (
        f"{RUN}/hermetic.py",
        '    ("torch", "get_default_dtype", "set_default_dtype", "float32"),\n',
        "",
        _CLEAN,
        "behind",
    ),
    (f"{RUN}/hermetic.py", '    ("torch", "get_num_threads", "set_num_threads", None),\n', "", _CLEAN, "behind"),
    (
        "exmesh_graph/types/results.py",
        "for fault in figure_faults(self.values):",
        "for fault in ():",
        _RUNS,
        "headline",
    ),
    (f"{G}/language/check.py", '("failures", "logs")', '("failures",)', _HOLES, "called_like"),
    (f"{G}/language/wires.py", 'if "<locals>" in definition', 'if "<made>" in definition', _HOLES, "factory"),
    (f"{G}/language/yamlfile.py", "if _CONTROL.search(node.value):", "if False:", _HOLES, "turned_round"),
    (
        f"{G}/language/yamlfile.py",
        "value.bit_length() > 64",
        "value.bit_length() > 1e9",
        f"{TESTS}/test_graph_untrusted.py",
        "bombs",
    ),
)

_KEPT = f"{TESTS}/test_graph_kept.py"

RESULTS = _group(
    "what was served wrong to a third party that looked at results alone",
    (
        f"{CACHE}/syntax.py",
        "ast.Subscript)) and not isinstance(item.ctx, ast.Load):\n            return",
        "ast.Subscript)) and False:\n            return",
        _KEPT,
        "does_to_others",
    ),
    (f"{CACHE}/syntax.py", "called = [*called, *item.args, ", "called = [*called, ", _KEPT, "does_to_others"),
    (f"{CACHE}/syntax.py", "yield from [item.target.id]", "yield from []", _KEPT, "does_to_others"),
    (f"{CACHE}/syntax.py", "yield from item.names if", "yield from [] if", _KEPT, "does_to_others"),
    (f"{CACHE}/syntax.py", "isinstance(item, ast.AugAssign) or", "", _KEPT, "does_to_others"),
    (f"{CACHE}/moduletext.py", "if calls or not all", "if not all", _KEPT, "re_exports"),
    (f"{RUN}/execute.py", "    return again\n", "    return value\n", _HOLES, "in_memory"),
    (f"{RUN}/execute.py", "if alike and stored.bytes > _SMALL", "if stored.bytes > _SMALL", _HOLES, "in_memory"),
    (_HELD, "made = item.__reduce_ex__(4)", 'made = ""', _KEPT, "marks"),
    ("exmesh_graph/api/unseen.py", "if fills and", "if False and", _KEPT, "strangers"),
    ("exmesh_graph/api/unseen.py", "if module not in found", "if False", _KEPT, "somebody_else"),
    (
        "exmesh_graph/api/unseen.py",
        "(line, words) for line, words, owner in",
        "(line, words) for line, words, owner in () and",
        _KEPT,
        "from_a_function",
    ),
    ("exmesh_graph/api/unseen.py", "if owner in called or", "if True or", _KEPT, "filling"),
    ("exmesh_graph/api/kept.py", "if isinstance(item, ast.Global) and", "if False and", _KEPT, "functions_keep"),
    ("exmesh_graph/api/kept.py", "if end in _GOING_ON or", "if", _KEPT, "functions_keep"),
    (f"{RUN}/backends/worker.py", ', separators=(",", ":")', "", _HOLES, "spoils_json"),
    (f"{RUN}/backends/worker.py", "        loads(data)  #", "        #", _HOLES, "spoils_json"),
)

_CHECKPOINT, _STATE = f"{TESTS}/test_graph_checkpoint.py", "exmesh_graph/types/state.py"

ROLES = _group(
    "which path holds which file, edited base types, order of maps, what a checkpoint brings back",
    (f"{CACHE}/keys.py", "for name in sorted(bound.signature.path_fields)}", "for name in ()}", _HOLES, "which_path"),
    (f"{CACHE}/keys.py", "path in own or not set(own).isdisjoint(path.parents)", "path in own", _HOLES, "which_path"),
    (
        f"{CACHE}/keys.py",
        "if bound.sources and list(beside.values()) == [_files(bound.sources)]:",
        "if len(beside) == 1:",
        _HOLES,
        "which_path",
    ),
    (
        f"{CACHE}/keys.py",
        "return [_without_paths(item, bound) for item in value] or None",
        "return sorted([_without_paths(item, bound) for item in value], key=str) or None",
        _HOLES,
        "which_path",
    ),
    (f"{CACHE}/keys.py", "and known[name] not in declared:", "and False:", _HOLES, "takes_as_its_base"),
    (
        f"{RUN}/execute.py",
        "for kind in kinds for name in sources_changed(",
        "for kind in () for name in (",
        _HOLES,
        "base",
    ),
    (f"{RUN}/execute.py", "if key_of(now) != job.key else", "if False else", _HOLES, "base"),
    (f"{RUN}/execute.py", "if changed or touched:", "if changed:", _HOLES, "there_and_back"),
    (f"{CACHE}/moduletext.py", "spec_of(self.name) is not self.spec or (data", "(data", _HOLES, "there_and_back"),
    (f"{CACHE}/keys.py", "unlisted = not found and own[1].is_file()", "unlisted = False", _HOLES, "which_path"),
    (f"{RUN}/execute.py", "with ALONE, ", "with ", _HOLES, "two_threads"),
    (
        f"{CACHE}/fingerprint.py",
        'return name.partition(".")[0] != MAIN',
        "return name.partition('.')[0] not in sys.stdlib_module_names",
        _KEPT,
        "one_of_pythons",
    ),
    (f"{CACHE}/fingerprint.py", ", **found, **followed}", ", **found}", _KEPT, "re_exported"),
    (f"{CACHE}/moduletext.py", "(unchecked or held[:16] == taken)", "held[:16] == taken", _CODE, "never_checks"),
    (_STATE, "if type(value) in _KINDS.values():", "if isinstance(value, Mapping):", _CHECKPOINT, "another_kind"),
    (f"{G}/declare/components.py", "for name in sorted(value)}", "for name in value}", _HOLES, "order_of_a_map"),
    (f"{RUN}/job.py", "in_order(bound.params", "(bound.params", _HOLES, "order_of_a_map"),
    (
        f"{G}/declare/components.py",
        '"params": in_order(self.params())',
        '"params": self.params()',
        _HOLES,
        "order_of_a_map",
    ),
    (f"{RUN}/hermetic.py", "    sys.meta_path.insert(0, seeding)\n", "", _CLEAN, "imports_first"),
    (f"{RUN}/checkpoint.py", "draw_on(generators)", "pass", _CHECKPOINT, "go_on"),
    (f"{RUN}/hermetic.py", '    if states["numpy"]:\n', "    if False:\n", _CHECKPOINT, "go_on"),
    (f"{RUN}/checkpoint.py", ' or record["format"] != FORMAT:', ":", _CHECKPOINT, "another_format"),
    (_STATE, "if id(value) in self.seen:", "if False:", _CHECKPOINT, "shares_memory"),
    (_STATE, "if len(members) > 1 or alike:", "if alike:", _CHECKPOINT, "shares_memory"),
    (_STATE, 'else {"fixed": True}', "else {}", _CHECKPOINT, "shares_memory"),
    (_STATE, "if type(value) is float:", "if isinstance(value, float):", _CHECKPOINT, "a_solver_keeps"),
)

MUTANTS = [*CORE, *HOLES, *REACH, *LESSONS, *RESULTS, *ROLES]
