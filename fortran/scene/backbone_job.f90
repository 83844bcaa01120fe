!> The &backbone group of a scene: free motions of a system without losses, grown from a
!! linear mode; of a pendulum also families that leave them.
module viscovib_backbone_job
  use viscovib_backbone, only: follow_backbone
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_checks, only: check_positive
  use viscovib_curve_branch, only: curve_branch_type, curve_options
  use viscovib_curve_groups, only: check_between, read_curve, read_switch, read_yes
  use viscovib_free_family, only: follow_family, free_family_type, free_options
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: equations_printed, new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: backbone_job, read_backbone, read_free, plan_backbone, plan_free, run_backbone, &
            run_free

  character(len=*), parameter, public :: backbone_parameters(2) = &
    [character(len=9) :: 'amplitude', 'energy']
  character(len=*), parameter :: pendulum_names(3) = [character(len=3) :: 'z', 'phi', 'psi']
  integer, parameter :: max_harmonics = 199

  type :: backbone_job
    !> The linear mode, counted from 0.
    integer :: mode = 0
    !> Place in `backbone_parameters`, and the coordinate whose amplitude counts.
    integer :: parameter = 1, dof = 0
    type(curve_options) :: options
    !> Highest order: of the mode's frequency.
    integer :: harmonics = 9
    !> Of a pendulum: periods of the mode in one of the motion; whether only motions that
    !! share the symmetry are kept; branch points to leave at.
    integer :: subharmonic = 1
    logical :: stability = .false., symmetric = .false.
    integer, allocatable :: switch(:)
  end type backbone_job

contains

  !> Of a mount or a polynomial system.
  subroutine read_backbone(reader, system, coordinates, job)
    type(group_reader), intent(inout) :: reader
    class(oscillator_type), intent(in) :: system
    character(len=*), intent(in) :: coordinates(:)
    type(backbone_job), intent(out) :: job
    type(backbone_plan_type) :: plan
    type(status_type) :: status
    character(len=:), allocatable :: word, name

    allocate (job%switch(0))
    job%mode = reader%read_integer('mode', 0)
    call read_ends(reader, job)
    job%harmonics = reader%read_integer('harmonics', job%harmonics)
    call read_curve(reader, job%options)
    name = ''
    if (reader%has('dof')) then
      word = reader%read_text('dof', allowed=coordinates, choice=job%dof)
      if (job%dof > 0) name = trim(coordinates(job%dof))
    end if
    if (reader%status%failed()) return
    call new_backbone_plan(plan, system, job%mode, job%dof, name, job%harmonics, &
                           job%options%tolerance, status)
    call reader%place(status)
    if (status%failed() .or. job%dof > 0) return
    word = reader%read_text('dof', trim(coordinates(plan%dof)), coordinates, job%dof)
  end subroutine read_backbone

  !> Of a pendulum.
  subroutine read_free(reader, pendulum, job)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(in) :: pendulum
    type(backbone_job), intent(out) :: job
    character(len=:), allocatable :: word
    real(wp) :: omega(3), shapes(3, 3)
    integer :: symmetry

    job%mode = reader%read_integer('mode', 0)
    word = reader%read_text('parameter', trim(backbone_parameters(1)), backbone_parameters, &
                            job%parameter)
    call read_ends(reader, job)
    job%subharmonic = reader%read_integer('subharmonic', 1)
    job%harmonics = reader%read_integer('harmonics', 15)
    call read_curve(reader, job%options)
    job%stability = read_yes(reader, 'stability')
    word = reader%read_text('symmetry', 'any', [character(len=4) :: 'any', 'kept'], symmetry)
    job%symmetric = symmetry == 2
    call read_switch(reader, job%switch)
    if (reader%status%failed()) return
    call check_between(reader, 'mode', job%mode, 0, 2)
    call check_between(reader, 'subharmonic', job%subharmonic, 1, 20)
    if (reader%status%failed()) return
    call check_between(reader, 'harmonics', job%harmonics, 1, max_harmonics/job%subharmonic)
    if (pendulum%parameters%equations == equations_printed .and. job%mode > 0) then
      call reader%complain('mode', 'mode = '//show(job%mode)//': the printed equations keep no ' &
                           //'energy in swings, must be 0 with them')
    end if
    if (job%parameter > 1) then
      call reader%refuse(['dof'], "goes with parameter = 'amplitude' only")
      return
    end if
    call pendulum%natural_modes(omega, shapes)
    associate (shape => shapes(:, job%mode + 1))
      word = reader%read_text('dof', trim(pendulum_names(maxloc(abs(shape), 1))), &
                              pendulum_names, job%dof)
      if (reader%status%failed()) return
      if (.not. abs(shape(job%dof)) > 0.0_wp) then
        call reader%complain('dof', "dof = '"//trim(pendulum_names(job%dof)) &
                             //"': stands still in mode "//show(job%mode))
      end if
    end associate
  end subroutine read_free

  !> Sizes from which and to which.
  subroutine read_ends(reader, job)
    type(group_reader), intent(inout) :: reader
    type(backbone_job), intent(inout) :: job
    type(status_type) :: status

    job%options%start = reader%read_real('from')
    job%options%finish = reader%read_real('to')
    if (reader%status%failed()) return
    call check_positive('from', job%options%start, status)
    call reader%place(status)
    if (.not. job%options%finish > job%options%start) then
      call reader%complain('to', 'to = '//show(job%options%finish)//': must be greater than from')
    end if
  end subroutine read_ends

  !> What will be computed of a mount or a polynomial system.
  subroutine plan_backbone(job, system, text, status)
    type(backbone_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(backbone_plan_type) :: plan

    text = ''
    call new_backbone_plan(plan, system, job%mode, job%dof, '', job%harmonics, &
                           job%options%tolerance, status)
    if (.not. status%failed()) text = plan%text(job%options%start, job%options%finish)
  end subroutine plan_backbone

  !> What will be computed of a pendulum.
  function plan_free(job, pendulum) result(text)
    type(backbone_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    text = 'computes: free motions of mode '//show(job%mode)//' from ' &
           //trim(backbone_parameters(job%parameter))//' '//show(job%options%start)//' to ' &
           //show(job%options%finish)//', ' &
           //show(count(kept_orders(pendulum, job%mode, job%harmonics*job%subharmonic, &
                                    job%subharmonic, job%symmetric)))//' cosines'//nl &
           //'skips: damping and loads (free motions of the system without losses)'//nl &
           //'skips: sines (motions that begin at rest are even in time)'//nl &
           //trim(merge('computes: Floquet multipliers   ', 'skips: stability (not asked for)', &
                        job%stability))//nl
    if (size(job%switch) > 0) then
      text = text//'computes: '//show(size(job%switch)) &
             //trim(merge(' family that leaves it ', ' families that leave it', &
                          size(job%switch) == 1))//nl
    else
      text = text//'skips: families that leave it (no switch)'//nl
    end if
  end function plan_free

  !> The family of a mount or a polynomial system, and the orders kept.
  subroutine run_backbone(job, system, orders, family, status)
    type(backbone_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    integer, allocatable, intent(out) :: orders(:)
    type(free_family_type), intent(out) :: family
    type(status_type), intent(out) :: status
    type(backbone_plan_type), target :: plan
    type(curve_branch_type) :: branch
    integer :: never

    call new_backbone_plan(plan, system, job%mode, job%dof, '', job%harmonics, &
                           job%options%tolerance, status)
    if (status%failed()) return
    never = 0
    call follow_backbone(plan%system, plan%set, plan%omega, plan%shape, plan%dof, job%options, &
                         branch, never)
    orders = plan%set%orders
    associate (n => branch%n_points, m => size(branch%x, 1) - 1)
      family%outcome = branch%outcome
      family%parameter = branch%parameter(:n)
      family%nu = branch%x(m + 1, :n)
      family%x = branch%x(2:m:2, :n)
    end associate
    family%folds = branch%folds%p(:branch%folds%n)
    allocate (family%branch_p(0))
    call check_begun(family, job, status)
  end subroutine run_backbone

  !> The family of a pendulum, then those that leave it, in the order asked for.
  subroutine run_free(job, pendulum, orders, families, status)
    type(backbone_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    integer, allocatable, intent(out) :: orders(:)
    type(free_family_type), allocatable, intent(out) :: families(:)
    type(status_type), intent(out) :: status
    type(pendulum_type), target :: system
    type(pendulum_parameters) :: parameters
    type(free_options) :: options
    real(wp), allocatable :: begin(:, :)
    real(wp) :: omega(3), shapes(3, 3)
    integer :: highest, i, n, place

    allocate (families(1 + size(job%switch)))
    parameters = pendulum%parameters
    parameters%damping = 0.0_wp
    parameters%load = 0.0_wp
    call new_pendulum(system, parameters, status)
    if (status%failed()) return
    call system%natural_modes(omega, shapes)
    highest = job%harmonics*job%subharmonic
    orders = [(i, i=0, highest)]
    options%kept = kept_orders(pendulum, job%mode, highest, job%subharmonic, job%symmetric)
    options%unit = omega(job%mode + 1)/job%subharmonic
    options%dof = job%dof
    options%order = job%subharmonic
    options%curve = job%options
    options%stability = job%stability
    allocate (begin(highest + 1, 3), source=0.0_wp)
    place = job%dof
    if (place == 0) place = maxloc(abs(shapes(:, job%mode + 1)), 1)
    begin(job%subharmonic + 1, :) = shapes(:, job%mode + 1)/shapes(place, job%mode + 1)
    associate (first => families(1))
      call follow_family(first, system, options, [begin], status)
      if (.not. status%failed()) call check_begun(first, job, status)
      if (status%failed()) return
      do i = 1, size(job%switch)
        n = abs(job%switch(i))
        if (n > size(first%branch_p)) then
          call fail(status, status_input_error, 'switch', 'switch = '//show(job%switch(i)) &
                    //': the backbone has '//show(size(first%branch_p))//' branch points')
          return
        end if
        call follow_family(families(i + 1), system, options, first%branch_x(:, n), status, &
                           begin_nu=first%branch_nu(n), begin_p=first%branch_p(n), &
                           along=sign(1, job%switch(i))*first%across(:, n))
        if (status%failed()) return
      end do
    end associate
  end subroutine run_free

  subroutine check_begun(family, job, status)
    type(free_family_type), intent(in) :: family
    type(backbone_job), intent(in) :: job
    type(status_type), intent(inout) :: status
    if (size(family%nu) > 0) return
    call fail(status, status_input_error, 'from', 'from = '//show(job%options%start) &
              //': no solution was found there: begin lower')
  end subroutine check_begun

  !> Which orders of z, phi, psi are unknowns, shape (highest + 1, 3): the printed equations
  !! keep energy in z only; motions that share the symmetry are mirrored in phi and psi half a
  !! period later, and those of mode 0 do not swing.
  pure function kept_orders(pendulum, mode, highest, multiple, symmetric) result(kept)
    type(pendulum_type), intent(in) :: pendulum
    integer, intent(in) :: mode, highest, multiple
    logical, intent(in) :: symmetric
    logical :: kept(highest + 1, 3)
    integer :: k

    kept = .true.
    if (mode == 0 .and. (symmetric .or. pendulum%parameters%equations == equations_printed)) then
      kept(:, 2:) = .false.
    else if (symmetric) then
      kept(:, 1) = [(mod(k, 2*multiple) == 0, k=0, highest)]
      kept(:, 2:) = spread([(mod(k, 2*multiple) == multiple, k=0, highest)], 2, 2)
    end if
  end function kept_orders

end module viscovib_backbone_job
