import cProfile,pstats,sys,time,json
sys.argv=['zygos','explain',*sys.argv[2:]] if False else sys.argv
out=sys.argv[1]; args=sys.argv[2:]
from zygos.cli import main
p=cProfile.Profile(); t=time.process_time()
try:
    p.enable(); 
    try: main(args)
    except SystemExit as e: print('exit',e.code)
finally:
    p.disable(); print('CPU',time.process_time()-t); p.dump_stats(out)
