"""Makes sky_coordinates.json: headers, and the 0-based pixels of astropy for sky positions."""
import json, numpy as np
from astropy.wcs import WCS
from astropy.io import fits
rng=np.random.default_rng(3)
base=dict(CRPIX1=512.5,CRPIX2=300.25,CRVAL1=150.1,CRVAL2=2.2,CTYPE1="RA---TAN",CTYPE2="DEC--TAN")
cd=dict(CD1_1=-5e-5,CD1_2=1.2e-5,CD2_1=1.1e-5,CD2_2=5.1e-5)
def proj(p,**k): return {**base,**cd,"CTYPE1":"RA---"+p,"CTYPE2":"DEC--"+p,**k}
sip={f"{n}_{p}_{q}":float(rng.normal()*3*10.**(-2.5*(p+q))/ (1 if p+q>1 else 1)) for n in "AB" for p in range(4) for q in range(4-p) if p+q>=2}
sip={k:v*1e-1 for k,v in sip.items()}
ap={f"{n}P_{p}_{q}":1e-9 for n in "AB" for p in range(3) for q in range(3-p)}
pv={f"PV{i}_{m}":float((1 if m==1 else 0)+rng.normal()*1e-3*{0:1e-2,1:1,2:1,3:0}.get(m,1)) for i in (1,2) for m in range(11) if m!=3}
cases={
 "tan":proj("TAN"), "sin":proj("SIN"), "zea":proj("ZEA"), "arc":proj("ARC"), "stg":proj("STG"),
 "lonpole":proj("ZEA",LONPOLE=150.0), "pole":proj("TAN",CRVAL2=90.0), "near-pole":proj("TAN",CRVAL1=10.,CRVAL2=-89.99),
 "wrap":proj("TAN",CRVAL1=0.001), "negative":proj("TAN",CRVAL1=-30.0),
 "pc":{**base,"CDELT1":-6e-5,"CDELT2":5e-5,"PC1_1":.9,"PC1_2":-.4,"PC2_1":.38,"PC2_2":.95},
 "crota":{**base,"CDELT1":-6e-5,"CDELT2":5e-5,"CROTA2":33.0},
 "cdelt":{**base,"CDELT1":-6e-5,"CDELT2":5e-5},
 "swapped":{**base,"CTYPE1":"DEC--TAN","CTYPE2":"RA---TAN","CRVAL1":2.2,"CRVAL2":150.1,"CD1_1":5e-5,"CD1_2":1e-6,"CD2_1":1e-6,"CD2_2":-5e-5},
 "tan-sip":proj("TAN-SIP",A_ORDER=3,B_ORDER=3,**sip), "tan-sip-inverse":proj("TAN-SIP",A_ORDER=3,B_ORDER=3,AP_ORDER=2,BP_ORDER=2,**sip,**ap),
 "tpv":proj("TPV",CD1_1=-7e-5,CD2_2=7e-5,**pv), "scamp":proj("TAN",**pv),
 "old-pc":{**base,"CDELT1":-6e-5,"CDELT2":5e-5,"PC001001":-.9,"PC001002":-.4,"PC002001":.38,"PC002002":.95},
 "older-pc":{**base,"CDELT1":-6e-5,"CDELT2":5e-5,"PC01_01":.9,"PC01_02":-.4,"PC02_01":.38,"PC02_02":.95},
 "old-cd":{**base,"CD001001":-5e-5,"CD001002":1.2e-5,"CD002001":1.1e-5,"CD002002":5.1e-5},
 "arcsec":{**base,"CUNIT1":"arcsec","CUNIT2":"arcmin","CRVAL1":150.1*3600,"CRVAL2":2.2*60,"CDELT1":-.216,"CDELT2":3e-3,"PC1_1":.9,"PC1_2":-.4,"PC2_1":.38,"PC2_2":.95},
 "sip-unsaid":proj("TAN-SIP"),
 "zpn":proj("ZPN",PV2_1=1.0,PV2_3=44.0,PV2_5=-10300.0), "zpn-sky":{**base,"CTYPE1":"RA---ZPN","CTYPE2":"DEC--ZPN","CDELT1":-.1,"CDELT2":.1,"PV2_1":0.9,"PV2_3":-.02},
 "car":{**base,"CTYPE1":"RA---CAR","CTYPE2":"DEC--CAR","CDELT1":-.1,"CDELT2":.1}, "car-south":{**base,"CRVAL2":-40.0,"CTYPE1":"RA---CAR","CTYPE2":"DEC--CAR","CDELT1":-.05,"CDELT2":.05},
 "car-equator":{**base,"CRVAL2":0.0,"CTYPE1":"RA---CAR","CTYPE2":"DEC--CAR","CDELT1":-.05,"CDELT2":.05},
 "wide-zea":{**base,"CTYPE1":"RA---ZEA","CTYPE2":"DEC--ZEA","CDELT1":-.1,"CDELT2":.1},
}
out=[]
for name,h in cases.items():
    hd=fits.Header()
    for k,v in h.items(): hd[k]=v
    w=WCS(hd)
    px=np.array([[0,0],[1023,0],[0,700],[511.5,299.25],[300.3,77.7],[-50,900.]])
    sky=w.all_pix2world(px,0)
    back=w.all_world2pix(sky,0,tolerance=1e-10,maxiter=100)
    assert np.abs(back-px).max()<1e-7,(name,np.abs(back-px).max())
    if name=="swapped": sky=sky[:,::-1]
    out.append({"name":name,"header":h,"pixels":px.tolist(),"sky":sky.tolist()})
    if 'sip' in name: print(name, np.abs(w.wcs_pix2world(px,0)-sky).max()/5e-5,'px of distortion')
json.dump(out,open('sky_coordinates.json','w'),indent=None)
