!> Doing what a scene asks for.
module viscovib_run_scene
  use viscovib_backbone_job, only: backbone_parameters, plan_backbone, plan_free, run_backbone, &
    run_free
  use viscovib_backbone_table, only: write_backbone
  use viscovib_branch_job, only: plan_branch, run_branch, write_branch
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_outcomes
  use viscovib_dense, only: factorize, solve
  use viscovib_files, only: stem
  use viscovib_driven_job, only: driven_branch, plan_driven, run_driven, write_driven
  use viscovib_forced_response, only: forced_response
  use viscovib_free_family, only: free_family_type
  use viscovib_hereditary_job, only: hereditary_methods, plan_hereditary, run_hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_stability, only: stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_polynomial_job, only: plan_polynomial, run_polynomial_job
  use viscovib_response, only: response_type
  use viscovib_response_plan, only: new_response_plan, response_plan_type
  use viscovib_response_table, only: write_response
  use viscovib_scales_job, only: plan_scales, run_oscillator_scales, &
    run_pendulum_scales, stable_points, write_scales
  use viscovib_scales_response, only: steady_points_type
  use viscovib_scene, only: scene_type
  use viscovib_simulate, only: run_completed, run_names
  use viscovib_spectrum_table, only: write_spectrum
  use viscovib_table, only: listed_units
  use viscovib_tabulated, only: tabulated_unseen, unseen_integral
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_pendulum_job, only: plan_pendulum, run_pendulum_job
  use viscovib_transient_job, only: trajectory_type
  use viscovib_transient_table, only: write_transient
  use viscovib_windows, only: window_names
  implicit none
  private

  public :: scene_report, plan_scene, run_scene, scene_warnings

  type :: scene_report
    !> Table written, and a sentence about it.
    character(len=:), allocatable :: path, summary
    logical :: complete = .true.
  end type scene_report

contains

  !> What will be computed and what is skipped, with the reasons.
  subroutine plan_scene(scene, text, status)
    type(scene_type), intent(in), target :: scene
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan

    text = ''
    if (scene%sweep_line > 0) then
      call fail(status, status_input_error, 'sweep', scene%path//':'//show(scene%sweep_line) &
                //': &sweep: sweeps are run by Python (viscovib sweep SCENE); this program runs ' &
                //'single points, leave the group out')
      return
    end if
    if (scene%wants_scales) then
      text = plan_scales(scene%scales)
      return
    else if (scene%is_pendulum .and. scene%wants_branch) then
      text = plan_driven(scene%driven)
      return
    else if (scene%wants_backbone) then
      if (scene%is_pendulum) then
        text = plan_free(scene%backbone, scene%pendulum)
      else
        call plan_backbone(scene%backbone, scene%oscillator(), text, status)
      end if
      text = text//plan_table(scene)
      return
    else if (scene%wants_motion) then
      if (scene%has_memory) then
        text = plan_hereditary(scene%hereditary, scene%oscillator(), scene%load)
      else
        text = plan_own_motion(scene)
      end if
      text = text//plan_table(scene)
      if (scene%spectrum%wanted) then
        text = text//'computes: spectra of '//joined(scene%coordinates(scene%transformed)) &
               //', window '//trim(window_names(scene%spectrum%window))//new_line('a') &
               //plan_unwanted('Fourier transforms', scene, scene%transformed)
      else
        text = text//'skips: Fourier transforms (no spectrum asked for)'//new_line('a')
      end if
      return
    end if
    call new_response_plan(plan, scene%oscillator(), scene%load, scene%nu, scene%method, &
                           scene%options, status)
    if (status%failed()) then
      status%message = scene%path//': '//status%message
    else if (scene%wants_branch) then
      text = plan_branch(varied(scene%branch%varies), scene%branch%curve%start, &
                         scene%branch%curve%finish, &
                         merge(0, size(plan%set%orders), plan%chosen), &
                         scene%branch%stability)//plan%rest//plan_table(scene)
    else
      text = plan%text//plan_table(scene)
    end if
  end subroutine plan_scene

  !> What varies along a branch, in words.
  function varied(name)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: varied
    varied = name
    if (name == 'load_factor') varied = 'load factor'
  end function varied

  !> The lines about a motion without memory.
  function plan_own_motion(scene) result(text)
    type(scene_type), intent(in) :: scene
    character(len=:), allocatable :: text
    if (scene%is_polynomial) then
      text = plan_polynomial(scene%transient, scene%polynomial, scene%load)
    else
      text = plan_pendulum(scene%transient, scene%pendulum)
    end if
  end function plan_own_motion

  !> The line about columns that are not wanted, if there are any.
  function plan_table(scene) result(text)
    type(scene_type), intent(in) :: scene
    character(len=:), allocatable :: text
    text = plan_unwanted('columns', scene, scene%wanted)
  end function plan_table

  function plan_unwanted(what, scene, wanted) result(text)
    character(len=*), intent(in) :: what
    type(scene_type), intent(in) :: scene
    integer, intent(in) :: wanted(:)
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    if (size(wanted) == size(scene%coordinates)) return
    text = 'skips: '//what//' of '//joined(pack(scene%coordinates, &
                                                [(all(wanted /= i), &
                                                  i=1, size(scene%coordinates))])) &
           //' (not asked for)'//new_line('a')
  end function plan_unwanted

  !> Compute what is wanted and write its table into a folder.
  subroutine run_scene(scene, folder, version, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, version
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: header, plan

    call plan_scene(scene, plan, status)
    if (status%failed()) return
    header = 'viscovib '//version//', scene '//scene%path//new_line('a')//scene%title &
             //new_line('a')//plan
    if (scene%wants_scales) then
      call run_steady(scene, folder, header, report, status)
    else if (scene%is_pendulum .and. scene%wants_branch) then
      call run_branches(scene, folder, header, report, status)
    else if (scene%wants_backbone) then
      call run_backbones(scene, folder, header, report, status)
    else if (scene%wants_motion) then
      call run_motion(scene, folder, header, report, status)
    else if (scene%wants_branch) then
      call run_one_branch(scene, folder, header, report, status)
    else
      call run_response(scene, folder, header, report, status)
    end if
  end subroutine run_scene

  subroutine run_response(scene, folder, header, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    type(response_type) :: response
    integer :: found, short

    call new_response_plan(plan, scene%oscillator(), scene%load, scene%nu, scene%method, &
                           scene%options, status)
    if (status%failed()) return
    call forced_response(plan, scene%oscillator(), scene%load, scene%nu, response)
    report%path = folder//'/'//stem(scene%path)//'_response.csv'
    found = count(response%outcome == outcome_converged)
    if (size(scene%wanted) < size(scene%coordinates)) then
      response%coefficients = response%coefficients(:, scene%wanted, :)
    end if
    call write_response(folder, stem(scene%path)//'_response.csv', response, &
                        scene%coordinates(scene%wanted), scene%units(scene%wanted), header, status)
    if (status%failed()) return
    short = count(pack(response%truncation, response%outcome == outcome_converged) &
                  > plan%options%tolerance)
    report%complete = found == size(scene%nu) .and. short == 0
    report%summary = show(found)//' of '//show(size(scene%nu))//' frequencies solved'
    if (short > 0) report%summary = report%summary//', '//show(short)//' with too few harmonics'
  end subroutine run_response

  subroutine run_one_branch(scene, folder, header, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    type(curve_branch_type) :: branch
    type(stability_type) :: stability
    type(crossing_type), allocatable :: crossings(:)
    integer, allocatable :: orders(:), highest(:)
    integer :: i, j, n, short

    call new_response_plan(plan, scene%oscillator(), scene%load, scene%nu, scene%method, &
                           scene%options, status)
    if (status%failed()) return
    call run_branch(scene%branch, plan, scene%oscillator(), scene%load, branch, orders, highest, &
                    stability, crossings, status)
    if (status%failed()) then
      status%message = scene%path//': '//status%message
      return
    end if
    report%path = folder//'/'//stem(scene%path)//'_branch.csv'
    if (size(scene%wanted) < size(scene%coordinates)) then
      n = 2*size(orders)
      branch%x = branch%x([((n*(scene%wanted(j) - 1) + i, i=1, n), j=1, size(scene%wanted))], :)
    end if
    call write_branch(folder, stem(scene%path)//'_branch.csv', scene%branch%varies, orders, &
                      highest, branch, stability, crossings, scene%coordinates(scene%wanted), &
                      scene%units(scene%wanted), header, status)
    if (status%failed()) return
    short = count(branch%truncation(:branch%n_points) > scene%branch%options%tolerance)
    report%complete = branch%outcome == curve_completed .and. short == 0
    report%summary = trim(curve_outcomes(branch%outcome))//', '//show(branch%n_points) &
                     //' points, '//show(branch%folds%n)//' folds'
    if (short > 0) report%summary = report%summary//', '//show(short)//' with too few harmonics'
  end subroutine run_one_branch

  !> A table for the branch, NAME_branch.csv, and for those that leave it,
  !! NAME_branch_1.csv and so on.
  subroutine run_branches(scene, folder, header, report, status)
    type(scene_type), intent(in) :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(driven_branch), allocatable :: branches(:)
    character(len=:), allocatable :: name
    integer :: i, short

    call run_driven(scene%driven, scene%pendulum, branches, status)
    if (status%failed()) then
      status%message = scene%path//': '//status%message
      return
    end if
    report%path = folder//'/'//stem(scene%path)//'_branch.csv'
    short = count(branches%truncation > scene%driven%options%tolerance)
    do i = 1, size(branches)
      name = stem(scene%path)//'_branch.csv'
      if (i > 1) name = stem(scene%path)//'_branch_'//show(i - 1)//'.csv'
      call write_driven(folder, name, scene%driven, branches(i), header, status)
      if (status%failed()) return
    end do
    associate (first => branches(1))
      report%complete = first%outcome == curve_completed .and. short == 0
      report%summary = trim(curve_outcomes(first%outcome))//', '//show(size(first%parameter)) &
                       //' points, '//show(size(first%folds))//' folds, ' &
                       //show(size(first%branch_points))//' branch points'
    end associate
    if (short > 0) report%summary = report%summary//', '//show(short)//' of '// &
                                    show(size(branches))//' branches with too few harmonics'
    if (size(branches) > 1) report%summary = report%summary//'; '//show(size(branches) - 1) &
                                             //' branches that leave it'
  end subroutine run_branches

  !> A table for the backbone, NAME_backbone.csv, and for the families that leave it,
  !! NAME_backbone_1.csv and so on.
  subroutine run_backbones(scene, folder, header, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(free_family_type), allocatable :: families(:)
    integer, allocatable :: orders(:)
    character(len=:), allocatable :: name
    integer :: i

    if (scene%is_pendulum) then
      call run_free(scene%backbone, scene%pendulum, orders, families, status)
    else
      allocate (families(1))
      call run_backbone(scene%backbone, scene%oscillator(), orders, families(1), status)
    end if
    if (status%failed()) then
      status%message = scene%path//': '//status%message
      return
    end if
    report%path = folder//'/'//stem(scene%path)//'_backbone.csv'
    do i = 1, size(families)
      name = stem(scene%path)//'_backbone.csv'
      if (i > 1) name = stem(scene%path)//'_backbone_'//show(i - 1)//'.csv'
      call write_backbone(folder, name, trim(backbone_parameters(scene%backbone%parameter)), &
                          orders, families(i), scene%wanted, scene%coordinates, scene%units, &
                          header, status)
      if (status%failed()) return
    end do
    associate (first => families(1))
      report%complete = first%outcome == curve_completed
      report%summary = trim(curve_outcomes(first%outcome))//', '//show(size(first%nu)) &
                       //' points, '//show(size(first%folds))//' folds'
      if (scene%is_pendulum) report%summary = report%summary//', '//show(size(first%branch_p)) &
                                              //' branch points'
    end associate
    if (size(families) > 1) report%summary = report%summary//'; tables of ' &
                                             //show(size(families) - 1)//' more'
  end subroutine run_backbones

  subroutine run_steady(scene, folder, header, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(steady_points_type) :: points
    integer :: i

    if (scene%is_pendulum) then
      call run_pendulum_scales(scene%scales, scene%pendulum, points, status)
    else
      call run_oscillator_scales(scene%scales, scene%oscillator(), points, status)
    end if
    if (status%failed()) then
      status%message = scene%path//': '//status%message
      return
    end if
    report%path = folder//'/'//stem(scene%path)//'_multiple_scales.csv'
    call write_scales(folder, stem(scene%path)//'_multiple_scales.csv', scene%scales, points, &
                      scene%coordinates, header, status)
    if (status%failed()) return
    report%complete = all([(any(points%value(:points%n) == i), i=1, size(scene%scales%values))])
    report%summary = show(points%n)//' steady motions at '//show(size(scene%scales%values)) &
                     //' values, '//show(count(stable_points(points)))//' of them stable'
  end subroutine run_steady

  !> Fastest natural frequency of a mount, or an upper bound of the rates of a polynomial
  !! system.
  real(wp) function fastest_frequency(scene) result(fastest)
    type(scene_type), intent(in), target :: scene
    real(wp) :: omega(2), shapes(2, 2)

    if (scene%is_polynomial) then
      fastest = largest_rate(scene%polynomial, scene%polynomial%n_dof())
    else
      call scene%mount%natural_modes(omega, shapes)
      fastest = omega(2)
    end if
  end function fastest_frequency

  !> Largest sums along a row of M^-1 K, its root, and of M^-1 C.
  real(wp) function largest_rate(system, n)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: n
    real(wp) :: mass(n, n), pull(n, n), drag(n, n)
    integer :: pivots(n), k
    logical :: singular

    mass = system%mass
    pull = matmul(system%spread, system%gather)
    drag = system%damping
    call factorize(n, mass, pivots, singular)
    do k = 1, n
      call solve(n, mass, pivots, pull(:, k))
      call solve(n, mass, pivots, drag(:, k))
    end do
    largest_rate = sqrt(maxval(sum(abs(pull), 2))) + maxval(sum(abs(drag), 2))
  end function largest_rate

  subroutine run_motion(scene, folder, header, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, header
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(trajectory_type) :: trajectory
    character(len=:), allocatable :: units, method
    real(wp) :: omega(3), shapes(3, 3)
    integer :: kept, i

    kept = 2
    if (scene%is_pendulum) then
      units = 'dimensionless: t in 1/omega_1'
      method = transient_methods(scene%transient%method)
      call scene%pendulum%natural_modes(omega, shapes)
      call run_pendulum_job(scene%transient, scene%pendulum, &
                            max(maxval(omega), maxval(scene%pendulum%drives)), trajectory, status)
    else
      units = 'units: t in s'
      if (scene%has_memory) then
        method = hereditary_methods(scene%hereditary%method)
        call run_hereditary_job(scene%hereditary, scene%oscillator(), scene%load, &
                                fastest_frequency(scene), trajectory, status)
      else
        method = transient_methods(scene%transient%method)
        call run_polynomial_job(scene%transient, scene%polynomial, scene%load, &
                                scene%motion%drives(1), scene%motion%fastest(), trajectory, &
                                status)
      end if
    end if
    if (status%failed()) then
      status%message = scene%path//': '//status%message
      return
    end if
    units = units//', '//listed_units(scene%coordinates(scene%wanted), scene%units(scene%wanted))
    report%path = folder//'/'//stem(scene%path)//'_transient.csv'
    if (scene%spectrum%wanted) then
      kept = count(trajectory%t >= scene%spectrum%discard*(1.0_wp - 1.0e-12_wp))
      if (kept >= 2) then
        call write_spectrum(folder, stem(scene%path)//'_spectrum.csv', &
                            transpose(trajectory%states(2*scene%transformed - 1, &
                                                        size(trajectory%t) - kept + 1:)), &
                            scene%coordinates(scene%transformed), &
                            trajectory%t(min(2, size(trajectory%t))), &
                            scene%spectrum%window, header, status)
      end if
      if (status%failed()) return
    end if
    if (size(scene%wanted) < size(scene%coordinates)) then
      trajectory%states = trajectory%states([(2*scene%wanted((i + 1)/2) - mod(i, 2), &
                                              i=1, 2*size(scene%wanted))], :)
    end if
    call write_transient(folder, stem(scene%path)//'_transient.csv', trajectory, &
                         trim(method), scene%coordinates(scene%wanted), units, header, status)
    if (status%failed()) return
    report%complete = trajectory%outcome == run_completed .and. kept >= 2
    report%summary = trim(run_names(trajectory%outcome))//' at t = '//show(trajectory%t_reached) &
                     //', '//show(size(trajectory%t))//' states'
    if (trajectory%error >= 0.0_wp) report%summary = report%summary//', estimated error ' &
                                                     //show(trajectory%error)
    if (kept < 2) report%summary = report%summary//'; no spectrum: '//show(kept) &
                                   //' states from discard on, must be at least 2'
  end subroutine run_motion

  pure function joined(words)
    character(len=*), intent(in) :: words(:)
    character(len=:), allocatable :: joined
    integer :: i
    joined = trim(words(1))
    do i = 2, size(words)
      joined = joined//', '//trim(words(i))
    end do
  end function joined

  !> A line for each kernel in use whose integral is not between 0 and 1.
  function scene_warnings(scene) result(text)
    type(scene_type), intent(in), target :: scene
    character(len=:), allocatable :: text
    class(oscillator_type), pointer :: system
    integer :: i

    text = ''
    if (scene%is_pendulum) return
    system => scene%oscillator()
    do i = 1, size(system%kernels)
      if (.not. any(system%kernel_of == i)) cycle
      associate (total => system%memory_scale*system%kernels(i)%kernel%integral())
        if (total >= 1) then
          text = text//'kernel integral = '//show(total)//' >= 1: the relaxed stiffness is not ' &
                 //'positive, and free motion creeps away slowly; the forced response without ' &
                 //'a mean does not feel it'//new_line('a')
        else if (total < 0) then
          text = text//'kernel integral = '//show(total)//' < 0: the spring stiffens with ' &
                 //'time, which no relaxation does'//new_line('a')
        end if
        associate (kernel => system%kernels(i)%kernel)
          if (unseen_integral(kernel) > tabulated_unseen*abs(kernel%integral())) then
            text = text//'kernel table: its first values rise towards t = 0 like a power of t: ' &
                   //'an integral of about '//show(unseen_integral(kernel))//' lies before its ' &
                   //'first time, which the table does not hold; the integral of the table is ' &
                   //show(kernel%integral())//new_line('a')
          end if
        end associate
      end associate
    end do
  end function scene_warnings

end module viscovib_run_scene
