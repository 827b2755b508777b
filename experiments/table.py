"""A table of the runs in a results folder: per method the mean over seeds with a 95 % t-interval, and every seed.

    python3 experiments/table.py results/intersection8
"""
import json
import math
import re
import sys
from pathlib import Path

# Quantile 0.975 of Student's t with 1, 2, ... degrees of freedom; the normal distribution's beyond.
T = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262]


def interval(values, digits=1):
    """Mean and t-interval over seeds."""
    n, mean = len(values), sum(values) / len(values)
    if n == 1:
        return f"{mean:.{digits}f}"
    half = (T[n - 2] if n - 2 < len(T) else 1.96) * math.sqrt(sum((v - mean) ** 2 for v in values) / (n - 1) / n)
    return f"{mean:.{digits}f} ± {half:.{digits}f}"


def rate(values):
    return interval([100 * v for v in values])


def read(path):
    """One run: what the evaluations of both checkpoints found, and how training went."""
    stem = str(path)[: -len(".last.json")]
    found = {which: json.loads(Path(f"{stem}.{which}.json").read_text())["metrics"] for which in ("best", "last")}
    lines = [json.loads(line) for line in Path(f"{stem}.metrics.jsonl").read_text().splitlines()]
    training = [line for line in lines if "steps_per_second" in line]
    first = next((line for line in lines if line.get("validation/success", 0) >= 0.971), None)
    method, seed = re.fullmatch(r"(.+)\.seed_(\d+)", Path(stem).name).groups()
    return {
        "method": method,
        "seed": int(seed),
        "steps": training[-1]["step"],
        "minutes": training[-1]["time/total_s"] / 60,
        "rate": training[-1]["step"] / training[-1]["time/total_s"],
        "first": first and (first["step"], first["time/total_s"] / 60),
        **found,
    }


def main():
    runs = sorted((read(p) for p in Path(sys.argv[1]).glob("*.last.json")), key=lambda r: (r["method"], r["seed"]))
    by_method = {}
    for run in runs:
        by_method.setdefault(run["method"], []).append(run)

    print("| method | seeds | success %, last | safety %, last | window reward, last | success %, best | worst seed, last | "
          "steps | minutes | steps/s | first validation ≥ 97.1 %: steps, minutes |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for method, group in by_method.items():
        def column(which, key):
            return [run[which][key]["mean"] for run in group]

        worst = 100 * min(column("last", "success"))
        reached = [run["first"] for run in group if run["first"]]
        first = "never"
        if reached:
            minutes = interval([f[1] for f in reached])
            first = f"{sum(f[0] for f in reached) / len(reached):,.0f}, {minutes}"
            if len(reached) < len(group):
                first += f" ({len(reached)} of {len(group)} seeds)"
        print(f"| {method} | {len(group)} | {rate(column('last', 'success'))} | {rate(column('last', 'safety'))} | "
              f"{interval(column('last', 'window_reward'))} | {rate(column('best', 'success'))} | {worst:.1f} | "
              f"{sum(r['steps'] for r in group) / len(group):,.0f} | {interval([r['minutes'] for r in group])} | "
              f"{sum(r['rate'] for r in group) / len(group):,.0f} | {first} |")

    print("\n| run | steps | minutes | success %, last | safety %, last | window, last | success %, best | window, best | "
          "world explained % | interaction explained % |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for run in runs:
        def cell(which, key, factor=100):
            m = run[which][key]
            return f"{factor * m['mean']:.1f} [{factor * m['low']:.1f}, {factor * m['high']:.1f}]"

        known = {k["name"]: f"{100 * k['explained']:.1f}" for k in run["last"]["reconstruction"]}
        print(f"| {run['method']} {run['seed']} | {run['steps']:,} | {run['minutes']:.1f} | {cell('last', 'success')} | "
              f"{cell('last', 'safety')} | {cell('last', 'window_reward', 1)} | {cell('best', 'success')} | "
              f"{cell('best', 'window_reward', 1)} | {known.get('world', '-')} | {known.get('interaction', '-')} |")


if __name__ == "__main__":
    main()
