// What the models that are on the page can be shown as, for the controls above them.
import { create } from "zustand";

export const useKinds = create<{ kinds: string[]; levels: number; faces: number; whole: number }>(() => ({ kinds: [], levels: 1, faces: 0, whole: 0 }));
