# The jobs of this repository; each sets up what it needs. `make help` lists them.

SHELL := /bin/bash
.DEFAULT_GOAL := help

SCENE ?=
CAMERAS ?=
VIA ?= host
FORMAT ?= png16
CASES ?= 2000
SEED ?= 0
MINUTES ?= 60

ENTER = . ./env.sh
# Before minutes of building: a scene is a file, or made of a recipe.
EXISTS = @case "$(1)" in ''|procedural:*|rooms:*) ;; *) test -e "$(1)" || { echo '$(1): No such file or directory'; exit 1; } ;; esac

.PHONY: help setup demo render simplify bench lab test fuzz sanitize soak lint docs pictures clean

help: ## This list
	@sed -nE 's/^([a-z]+):.*## (.*)/  make \1\t\2/p' Makefile | expand -t 16

setup: ## Install what is missing and build the packages
	@./setup.sh

demo: ## See a scene: SCENE=path, else a procedural one; UP="0 -1 0" where it stands another way up; IMU=1 with the IMU panel (GPL)
	$(call EXISTS,$(SCENE))
	@./setup.sh $(if $(IMU),imu)
	@$(ENTER); python -m rviz_gaussian_plugin.demo $(if $(SCENE),"$(SCENE)") $(if $(UP),--up $(UP))

render: ## Draw a scene's cameras: SCENE=path CAMERAS=file.json OUT=folder [VIA=host|rviz] [FORMAT=png16|png8|npy] [DETAIL=full|1.5px|800k] [MODEL=ray]
	@test -n "$(SCENE)" -a -n "$(CAMERAS)" || { echo 'make render needs SCENE=path and CAMERAS=file.json'; exit 1; }
	$(call EXISTS,$(SCENE))
	$(call EXISTS,$(CAMERAS))
	@./setup.sh lab
	@$(ENTER); python -m rosplat_lab.render "$(SCENE)" "$(CAMERAS)" "$(or $(OUT),out/render)" --via $(VIA) --format $(FORMAT) $(if $(DETAIL),--detail "$(DETAIL)") $(if $(MODEL),--model $(MODEL))

simplify: ## Fewer splats that look the same: IN=scene OUT=scene PSNR=50, or SPLATS=count or BYTES=20M [CAMERAS=path.json [TRAJECTORY=poses.txt|BAG:TOPIC] [MARGIN=metres]] [REFINE=minutes] [REPORT=file.json] [PICTURE=worst.png]
	@test -n "$(IN)" -a -n "$(OUT)" || { echo 'make simplify needs IN=scene OUT=scene, and PSNR=, SPLATS= or BYTES='; exit 1; }
	@test -n "$(PSNR)$(SPLATS)$(BYTES)" || { echo 'make simplify needs a bound: PSNR=, SPLATS= or BYTES='; exit 1; }
	$(call EXISTS,$(IN))
	@./setup.sh
	@$(ENTER); ros2 run rosplat_tools simplify "$(IN)" "$(OUT)" $(if $(PSNR),--psnr $(PSNR)) $(if $(SPLATS),--max-splats $(SPLATS)) $(if $(BYTES),--max-bytes $(BYTES)) $(if $(CAMERAS),--cameras "$(CAMERAS)") $(if $(TRAJECTORY),--trajectory "$(TRAJECTORY)") $(if $(MARGIN),--margin $(MARGIN)) $(if $(REFINE),--refine $(REFINE)) $(if $(REPORT),--report "$(REPORT)") $(if $(PICTURE),--picture "$(PICTURE)")

bench: ## Measure this machine: QUICK=1 for two minutes; SUBJECTS="sort frame" SCENES="a.ply b.spz" SIZES="500k 5M" DISPLAYS=file
	@./setup.sh lab
	@$(ENTER); python -m rosplat_lab.bench $(SUBJECTS) $(if $(QUICK),--quick) $(if $(SIZES),--sizes $(SIZES)) $(if $(SCENES),--scenes $(SCENES)) $(if $(DISPLAYS),--displays $(DISPLAYS))

lab: ## Chart error against time for all settings, and where pictures fail: [SCENE=path] [OUT=folder] [QUICK=1] [DOCS=folder] [PART=chart|atlas|pages]
	@./setup.sh lab
	@$(ENTER); python -m rosplat_lab.lab $(if $(SCENE),"$(SCENE)") --out "$(or $(OUT),out/lab)" $(if $(QUICK),--quick) $(if $(DOCS),--docs "$(DOCS)") $(if $(PART),--part $(PART))

fuzz: ## Messages, requests and files as no honest peer sends them, the C++ with sanitizers: CASES=100000 [SEED=0] [CASE=number]
	@./setup.sh dev
	@$(ENTER); tests/fuzz.sh $(CASES) $(SEED) $(CASE)

sanitize: ## The C++ tests with the compiler's sanitizers
	@./setup.sh dev
	@$(ENTER); tests/sanitized.sh tests

soak: ## An emulated SLAM run with all that goes wrong on robots, into out/soak/soak.json: MINUTES=60
	@./setup.sh lab
	@$(ENTER); python tests/soak.py --minutes $(MINUTES) --out out/soak

lint: ## Formats, style, types and licences
	@./setup.sh dev
	@$(ENTER); tests/lint.sh

test: ## Lint, then every test that this machine can run
	@./setup.sh dev
	@$(ENTER); tests/lint.sh && tests/run.sh

docs: ## The documentation as a site: out/docs/index.html
	@./setup.sh docs
	@$(ENTER); python -m sphinx -q -W --keep-going -d out/doctrees docs out/docs

pictures: ## Make the documentation's pictures, where rviz2 is: SCENE=playbot UPRIGHT=wolf.spz [ONLY="demo rviz"]
	@./setup.sh lab imu
	@$(ENTER); python docs/pictures.py "$(SCENE)" "$(UPRIGHT)" $(if $(ONLY),--only $(ONLY))

clean: ## Forget builds and pictures; the Python environments stay
	rm -rf .ros/*/{build,install,log} out
