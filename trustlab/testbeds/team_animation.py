"""The animation of a simulated team: one HTML page with its data and script inside, nothing fetched."""

from __future__ import annotations

import html
import json

import numpy as np

from trustlab.models.checks import finite_number

__all__ = ["animation_page"]

FRAMES, NUMBERS = 1500, 150_000
"""Frames at most, and coordinates in a page at most."""

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>$TITLE</title>
<style>
body{font:15px/1.4 system-ui,sans-serif;margin:1rem auto;max-width:1060px;padding:0 1rem;color:#222;background:#fff}
.views{display:grid;grid-template-columns:1fr 1fr 230px;gap:12px}
@media(max-width:900px){.views{grid-template-columns:1fr 1fr 24%}}@media(max-width:520px){.views{grid-template-columns:1fr}}
canvas{width:100%;border:1px solid #ccc;border-radius:6px;display:block}
h1{font-size:1.15rem;margin:.2rem 0}p{margin:.3rem 0}
h2{font-size:.85rem;margin:0 0 .2rem;font-weight:600}
.bar{display:flex;gap:10px;align-items:center;margin:.6rem 0}.bar input[type=range]{flex:1}
button{font:inherit;padding:.2rem .9rem}output{font-variant-numeric:tabular-nums;min-width:5.5em}
.key span{margin-right:1.1em;white-space:nowrap}.key b{display:inline-block;width:.8em;height:.8em;border-radius:50%;margin-right:.3em}
</style></head><body>
<h1>$TITLE</h1><p>$NOTE</p>
<div class="bar"><button id="play">Pause</button><input id="time" type="range" min="0" value="0" step="1" aria-label="time">
<output id="clock"></output><label>speed <input id="speed" type="number" min="0.1" step="any" style="width:5em" value="$RATE"></label></div>
<div class="views"><div><h2>from above (x, y) [m]</h2><canvas id="top"></canvas></div>
<div><h2>from the side (x, z) [m]</h2><canvas id="side"></canvas></div>
<div class="felt"><h2>force felt [N]</h2><canvas id="force"></canvas></div></div>
<h2 style="margin-top:.7rem">greatest distance to the goal [m]</h2><canvas id="far"></canvas>
<p class="key"><span><b style="background:#0072b2"></b>robot</span><span><b style="background:#d55e00"></b>leader</span>
<span><b style="background:#fff;border:2px solid #009e73"></b>goal</span><span id="told"></span></p>
<script>
"use strict";
const D=$DATA, by=id=>document.getElementById(id), F=D.t.length, N=D.names.length;
const slider=by("time"); slider.max=F-1;
function fit(c,ratio){const r=window.devicePixelRatio||1,w=c.clientWidth||300;c.width=w*r;c.height=w*ratio*r;c.style.height=w*ratio+"px";
 const g=c.getContext("2d");g.setTransform(r,0,0,r,0,0);g.clearRect(0,0,w,w*ratio);g.font="11px system-ui,sans-serif";return [g,w,w*ratio];}
function step(span){const raw=span/5,p=Math.pow(10,Math.floor(Math.log10(raw)));return [1,2,5,10].map(k=>k*p).find(k=>k>=raw);}
function dot(g,x,y,r,fill,line){g.beginPath();g.arc(x,y,r,0,7);if(fill){g.fillStyle=fill;g.fill();}if(line){g.strokeStyle=line;g.lineWidth=2;g.stroke();}}
function scene(id,a,b,f){const [g,w,h]=fit(by(id),1),m=26,s=(w-m-6)/D.span,X=v=>m+(v-D.low[a])*s,Y=v=>h-m-(v-D.low[b])*s;
 g.strokeStyle="#eee";g.fillStyle="#666";const d=step(D.span);
 for(let i=0;i<2;i++){const c=i?b:a;for(let v=Math.ceil(D.low[c]/d)*d;v<=D.low[c]+D.span;v+=d){g.beginPath();
  if(i){g.moveTo(m,Y(v));g.lineTo(w-6,Y(v));g.fillText(+v.toFixed(6),2,Y(v)+4);}else{g.moveTo(X(v),6);g.lineTo(X(v),h-m);g.fillText(+v.toFixed(6),X(v)-6,h-m+14);}g.stroke();}}
 const P=i=>D.q[f][i],lead=D.lead[f];
 g.strokeStyle="rgba(0,114,178,.18)";g.lineWidth=1;for(let i=0;i<N;i++){g.beginPath();for(let k=Math.max(0,f-150);k<=f;k++)g.lineTo(X(D.q[k][i][a]),Y(D.q[k][i][b]));g.stroke();}
 g.strokeStyle="#aaa";for(const [i,j] of D.links){g.beginPath();g.moveTo(X(P(i)[a]),Y(P(i)[b]));g.lineTo(X(P(j)[a]),Y(P(j)[b]));g.stroke();}
 dot(g,X(D.goal[a]),Y(D.goal[b]),10,null,"#009e73");dot(g,X(D.goal[a]),Y(D.goal[b]),2,"#009e73");
 for(let i=0;i<N;i++)if(i!==lead)dot(g,X(P(i)[a]),Y(P(i)[b]),5,"#0072b2","#fff");
 dot(g,X(P(lead)[a]),Y(P(lead)[b]),7,"#d55e00","#fff");}
function arrow(g,x,y,u,v){const l=Math.hypot(u,v);g.strokeStyle=g.fillStyle="#d55e00";g.lineWidth=3;g.beginPath();g.moveTo(x,y);g.lineTo(x+u,y+v);g.stroke();
 if(l>3){const c=u/l,s=v/l,k=Math.min(9,l);g.beginPath();g.moveTo(x+u+c*2,y+v+s*2);g.lineTo(x+u-k*c-k*.5*s,y+v-k*s+k*.5*c);g.lineTo(x+u-k*c+k*.5*s,y+v-k*s-k*.5*c);g.fill();}}
function felt(f){const [g,w,h]=fit(by("force"),1.0),c=(w-40)/2+6,r=c-14,F3=D.f[f];g.strokeStyle="#ddd";
 for(const part of [.5,1]){g.beginPath();g.arc(c,h/2,r*part,0,7);g.stroke();g.fillStyle="#666";g.fillText((D.most*part).toPrecision(2),c+4,h/2-r*part-3);}
 arrow(g,c,h/2,r*F3[0]/D.most,-r*F3[1]/D.most);g.fillStyle="#666";g.fillText("x, y",c-10,h-4);
 const zx=w-18;g.strokeStyle="#ddd";g.beginPath();g.moveTo(zx,h/2-r);g.lineTo(zx,h/2+r);g.stroke();arrow(g,zx,h/2,0,-r*F3[2]/D.most);g.fillStyle="#666";g.fillText("z",zx-3,h-4);}
function course(f){const c=by("far"),[g,w,h]=fit(c,.18),m=44,lo=Math.log10(D.tolerance)-1,hi=Math.log10(Math.max(...D.far))+.1,
 X=k=>m+(w-m-6)*D.t[k]/D.t[F-1],Y=v=>6+(h-30)*(hi-Math.max(Math.log10(v),lo))/(hi-lo);
 g.fillStyle="#666";for(let e=Math.ceil(lo);e<=hi;e++){g.fillText("1e"+e,8,Y(Math.pow(10,e))+4);g.strokeStyle="#eee";g.beginPath();g.moveTo(m,Y(Math.pow(10,e)));g.lineTo(w-6,Y(Math.pow(10,e)));g.stroke();}
 g.strokeStyle="#0072b2";g.lineWidth=1.5;g.beginPath();for(let k=0;k<F;k++)g.lineTo(X(k),Y(D.far[k]));g.stroke();
 g.strokeStyle="#d55e00";g.lineWidth=1;for(let k=1;k<F;k++)if(D.lead[k]!==D.lead[k-1]){g.beginPath();g.moveTo(X(k),h-22);g.lineTo(X(k),h-14);g.stroke();}
 g.fillText("switches of the leader",m,h-3);g.strokeStyle="#222";g.beginPath();g.moveTo(X(f),4);g.lineTo(X(f),h-22);g.stroke();}
function draw(){const f=Math.min(Math.floor(now),F-1);slider.value=f;by("clock").textContent=D.t[f].toFixed(1)+" s";scene("top",0,1,f);scene("side",0,2,f);felt(f);course(f);
 by("told").textContent="leader: "+D.names[D.lead[f]]+"  ·  greatest distance to the goal: "+(D.far[f]<.01?D.far[f].toExponential(1):D.far[f].toFixed(2))+" m";}
let now=0,running=true,last=null;const quiet=matchMedia("(prefers-reduced-motion: reduce)").matches;
function pause(p){running=!p;by("play").textContent=running?"Pause":"Play";last=null;if(running){if(now>=F-1)now=0;requestAnimationFrame(tick);}}
function tick(s){if(!running)return;if(last!==null)now+=(s-last)/1000*(+by("speed").value||1)/D.step;last=s;if(now>=F-1){now=F-1;pause(true);}draw();if(running)requestAnimationFrame(tick);}
by("play").onclick=()=>pause(running);slider.oninput=()=>{pause(true);now=+slider.value;draw();};window.onresize=draw;
const place=/^#t=([0-9.]+)$/.exec(location.hash);if(place){now=Math.min(+place[1]/D.step,F-1);}
draw();pause(quiet||!!place);
</script></body></html>
"""


class AnimationPage(str):
    """An animation as one HTML page: text to write to a file, shown in a frame by a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        framed = html.escape(self, quote=True)
        return f'<iframe srcdoc="{framed}" width="100%" height="900" style="border:0"></iframe>'

    def __repr__(self) -> str:
        return f"AnimationPage({len(self)} characters of HTML; write it with run.animate(path))"


def animation_page(run, rate: float = 5.0) -> str:
    """
    Return an animation of a run as one HTML page.

    Parameters
    ----------
    run : TeamRun
        What to show.
    rate : float
        Simulated seconds per second at the start.

    Raises
    ------
    ValueError
        If the rate is not positive.
    """
    rate = finite_number("rate", rate)
    if not rate > 0.0:
        raise ValueError(f"rate must be positive, got {rate}")
    end = len(run.t)
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 2, end)
    frames = min(FRAMES, max(NUMBERS // (3 * len(run.robots)), 50))
    part = slice(0, end, max(-(-end // frames), 1))
    t, q = run.t[part], run.positions[part]
    force = -run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy()[part]  # what the device does to the hand
    seen = np.concatenate([q.reshape(-1, 3), run.goal[None]])
    low, high = seen.min(axis=0), seen.max(axis=0)
    span = 1.1 * max(float((high - low).max()), 0.1)
    data = {
        "t": _short(t, 3),
        "step": float(t[1] - t[0]) if len(t) > 1 else 1.0,
        "q": _short(q, 4),
        "f": _short(force, 4),
        "most": max(float(np.linalg.norm(force, axis=1).max()), 1e-6),
        "lead": run.data["number"].to_numpy()[part].astype(int).tolist(),
        "far": [float(f"{value:.3g}") for value in np.maximum(run.distances.max(axis=1)[part], 1e-12)],
        "names": [str(name) for name in run.robots],
        "links": np.argwhere(np.triu(run.adjacency)).tolist(),
        "goal": run.goal.tolist(),
        "low": (0.5 * (low + high) - 0.5 * span).tolist(),
        "span": span,
        "tolerance": run.tolerance,
    }
    arrived = (
        f"all within {run.tolerance:g} m after {run.time_to_goal:.1f} s"
        if run.converged
        else "not all at the goal"
    )
    note = f"Synthetic: simulated robots, channel and operator; {arrived}."
    page = PAGE.replace("$TITLE", html.escape(run.label)).replace("$NOTE", html.escape(note))
    page = page.replace("$RATE", f"{rate:g}")
    return page.replace("$DATA", json.dumps(data, separators=(",", ":")).replace("</", "<\\/"))


def _short(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()
