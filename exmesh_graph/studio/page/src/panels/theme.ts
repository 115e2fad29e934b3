// Light, dark, or as the system says; remembered by the browser.
import { useEffect, useState } from "react";

type Theme = "system" | "light" | "dark";
const NEXT: { [theme in Theme]: Theme } = { system: "light", light: "dark", dark: "system" };

export function useTheme(): [Theme, () => void] {
  const [theme, set] = useState<Theme>(() => (localStorage.getItem("exmesh-theme") as Theme | null) ?? "system");
  useEffect(() => {
    document.documentElement.dataset.theme = theme;
    localStorage.setItem("exmesh-theme", theme);
  }, [theme]);
  return [theme, () => set(NEXT[theme])];
}
