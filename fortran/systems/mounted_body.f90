!> A rigid body in space on mounts as defined by the user, its static equilibrium under its weight,
!! and the systems for motion about it.
!!
!! Small rotations give a polynomial system, d_j = e_j . u with rows e_j; finite rotations give a
!! turning body (`viscovib_turning_body`). In static equilibrium of weight W and preloads g_j(0),
!!
!!   sum_j dd_j/dq (1 - I_j) [k_j d_j + g_j(d_j)] = W,
!!
!! with I_j the integral of the kernel, i.e. after complete relaxation.
module viscovib_mounted_body
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_rotation, only: cross, new_rotation, rotation_type
  use viscovib_rounded, only: brief
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_spring_about, only: force_of, spring_about, spring_at
  use viscovib_spring_products, only: add_products
  use viscovib_symmetric_modes, only: find_symmetric_modes
  use viscovib_turning_body, only: body_spring, new_turning_body, row_of, turning_body
  implicit none
  private

  public :: build_small, build_turning, mounted_body, place, preload_stiffness, rest_type, &
    spring_turned, springs_at_rest

  !> Springs are as defined by the user; laws depend on d and its rate, including linear parts.
  type :: mounted_body
    real(wp) :: mass = 0.0_wp, inertia(3, 3) = 0.0_wp, gravity(3) = 0.0_wp
    !> Angular momentum of internal rotors, in body axes (kg m^2/s).
    real(wp) :: spin(3) = 0.0_wp
    !> The same per speed of a rotor, the frequency of the load (kg m^2).
    real(wp) :: rotor(3) = 0.0_wp
    !> True for finite rotations; true for loads in body axes.
    logical :: exact = .false., loads_turn = .false.
    real(wp), allocatable :: base_direction(:)
    type(body_spring), allocatable :: springs(:)
    character(len=16), allocatable :: names(:)
    !> Mount of each spring, an index into `names`, and its local axis (0: none).
    integer, allocatable :: mount_of(:), axis_of(:)
    !> Fluid tracks, one coordinate each.
    real(wp), allocatable :: track_mass(:), track_damping(:)
  contains
    procedure :: n_dof
    procedure :: masses
    procedure :: find_rest
    procedure, private :: settle
    procedure, private :: balance
  end type mounted_body

  !> Static equilibrium: coordinates, deflections of springs, their forces, and the residual
  !! relative to weight and preloads.
  type :: rest_type
    real(wp), allocatable :: q(:), d(:), carried(:)
    real(wp) :: residual = 0.0_wp
  contains
    procedure :: axes
  end type rest_type

  !> Relative step at which Newton's method ends; tolerated relative residual of weight and
  !! preloads; smallest load increment; relative stiffness that counts as 0.
  real(wp), parameter :: settled = 1.0e-15_wp, accurate = 1.0e-9_wp, least_part = 1.0e-4_wp, &
                         no_stiffness = 1.0e-12_wp
  integer, parameter :: max_steps = 30
  real(wp), parameter :: tiny_step = 1.0e-100_wp, half_turn = 3.141592653589793_wp

contains

  pure integer function n_dof(self)
    class(mounted_body), intent(in) :: self
    n_dof = 6 + size(self%track_mass)
  end function n_dof

  !> Rotation matrix at static equilibrium; identity unless rotations are finite (`exact`).
  pure function axes(self, exact)
    class(rest_type), intent(in) :: self
    logical, intent(in) :: exact
    real(wp) :: axes(3, 3)
    type(rotation_type) :: turn
    complex(wp) :: v(3)
    integer :: a, b
    if (exact .and. allocated(self%q)) turn = new_rotation(cmplx(self%q(4:6), 0.0_wp, wp))
    do b = 1, 3
      v = cmplx([(merge(1.0_wp, 0.0_wp, a == b), a=1, 3)], 0.0_wp, wp)
      axes(:, b) = real(turn%turned(v))
    end do
  end function axes

  !> Mass matrix about the center of mass.
  pure function masses(self)
    class(mounted_body), intent(in) :: self
    real(wp) :: masses(6 + size(self%track_mass), 6 + size(self%track_mass))
    integer :: i
    masses = 0.0_wp
    do i = 1, size(masses, 1)
      if (i <= 3) masses(i, i) = self%mass
      if (i > 6) masses(i, i) = self%track_mass(i - 6)
    end do
    masses(4:6, 4:6) = self%inertia
  end function masses

  !> Find static equilibrium by load increments of weight and preloads; q = 0 without any.
  subroutine find_rest(self, kernels, rest, status)
    class(mounted_body), intent(in) :: self
    type(kernel_holder), intent(in) :: kernels(:)
    type(rest_type), intent(out) :: rest
    type(status_type), intent(out) :: status
    real(wp), dimension(size(self%springs)) :: kept, preload
    real(wp), dimension(self%n_dof()) :: weight, pushed, q
    real(wp) :: done, part, step, size_of
    logical :: found
    integer :: j

    call set_ok(status)
    allocate (rest%q(self%n_dof()), rest%d(size(self%springs)), rest%carried(size(self%springs)))
    rest%q = 0.0_wp
    rest%d = 0.0_wp
    rest%carried = 0.0_wp
    do j = 1, size(preload)
      call force_of(self%springs(j), 0.0_wp, preload(j), step)
    end do
    if (.not. (any(abs(self%gravity) > 0.0_wp) .or. any(abs(preload) > 0.0_wp))) return
    call find_kept(self%springs, kernels, kept, status)
    if (status%failed()) return
    weight = 0.0_wp
    weight(:3) = self%mass*self%gravity
    preload = kept*preload
    pushed = 0.0_wp
    do j = 1, size(preload)
      pushed = pushed + row_of(self%springs(j), size(pushed))*preload(j)
    end do
    size_of = max(maxval(abs(weight)), maxval(abs(pushed)))
    if (.not. size_of > 0.0_wp) size_of = 1.0_wp
    done = 0.0_wp
    step = 1.0_wp
    do while (done < 1.0_wp)
      part = min(done + step, 1.0_wp)
      q = rest%q
      call self%settle(kept, part*weight, (1.0_wp - part)*preload, size_of, q, rest, found, &
                       status)
      if (status%failed()) return
      if (found) then
        rest%q = q
        done = part
        cycle
      end if
      step = step/2.0_wp
      if (step >= least_part) cycle
      call fail(status, status_input_error, 'gravity', 'gravity: the mounts collapse under ' &
                //brief(100.0_wp*done)//' % of the weight' &
                //trim(merge(' and of preloads', '                ', any(abs(preload) > 0.0_wp))) &
                //', no static equilibrium was found beyond')
      return
    end do
  end subroutine find_rest

  !> 1 - I_j.
  subroutine find_kept(springs, kernels, kept, status)
    type(body_spring), intent(in) :: springs(:)
    type(kernel_holder), intent(in) :: kernels(:)
    real(wp), intent(out) :: kept(:)
    type(status_type), intent(out) :: status
    integer :: j

    call set_ok(status)
    kept = 1.0_wp
    do j = 1, size(springs)
      if (springs(j)%kernel == 0) cycle
      kept(j) = 1.0_wp - kernels(springs(j)%kernel)%kernel%integral()
      if (kept(j) > 0.0_wp) cycle
      if (kept(j) < -huge(1.0_wp)) then
        call fail(status, status_input_error, 'gravity', 'gravity: a kernel has no finite ' &
                  //'integral, so its mount creeps without end')
      else
        call fail(status, status_input_error, 'gravity', 'gravity: the integral of a kernel is ' &
                  //brief(1.0_wp - kept(j))//', must be below 1: its mount carries no load in ' &
                  //'the end')
      end if
      return
    end do
  end subroutine find_kept

  !> Newton's method for one load increment. `found` is false if it diverges or the equilibrium is
  !! unstable.
  subroutine settle(self, kept, weight, waiting, size_of, q, rest, found, status)
    class(mounted_body), intent(in) :: self
    real(wp), intent(in) :: kept(:), weight(:)
    !> Part of each spring's force that is not applied yet; magnitude of all loads.
    real(wp), intent(in) :: waiting(:), size_of
    real(wp), intent(inout) :: q(:)
    !> Gets deflections, forces and residual.
    type(rest_type), intent(inout) :: rest
    logical, intent(out) :: found
    type(status_type), intent(out) :: status
    real(wp) :: left(size(q)), tangent(size(q), size(q)), squares(size(q))
    real(wp) :: shapes(size(q), size(q)), push(size(q)), step(size(q)), mass(size(q), size(q))
    integer :: turn

    call set_ok(status)
    mass = self%masses()
    do turn = 1, max_steps
      call self%balance(kept, weight, waiting, q, rest%d, rest%carried, left, tangent)
      found = all(abs(tangent) < huge(1.0_wp)) .and. all(abs(left) < huge(1.0_wp))
      if (.not. found) return
      call find_symmetric_modes(mass, tangent, squares, shapes)
      push = matmul(left, shapes)
      where (abs(squares) > no_stiffness*maxval(abs(squares)))
        push = push/squares
      else where
        ! Free directions without load do not move.
        push = 0.0_wp
      end where
      step = matmul(shapes, push)
      q = q + step
      found = .not. (self%exact .and. norm2(q(4:6)) > half_turn)
      if (.not. found) return
      if (maxval(abs(step)) <= settled*maxval(abs(q))) exit
    end do
    call self%balance(kept, weight, waiting, q, rest%d, rest%carried, left, tangent)
    call find_symmetric_modes(mass, tangent, squares, shapes)
    push = matmul(left, shapes)
    where (abs(squares) > no_stiffness*maxval(abs(squares))) push = 0.0_wp
    if (maxval(abs(matmul(mass, matmul(shapes, push)))) > 1.0e-6_wp*size_of) then
      call fail(status, status_input_error, 'gravity', 'gravity: no mount supports the weight in ' &
                //'some direction')
      return
    end if
    rest%residual = maxval(abs(left))/size_of
    found = squares(1) >= -no_stiffness*maxval(abs(squares)) .and. rest%residual < accurate
  end subroutine settle

  !> Residual of the equilibrium at q, and the tangent stiffness.
  subroutine balance(self, kept, weight, waiting, q, d, carried, left, tangent)
    class(mounted_body), intent(in) :: self
    real(wp), intent(in) :: kept(:), weight(:), waiting(:), q(:)
    real(wp), intent(out) :: d(:), carried(:), left(:), tangent(:, :)
    real(wp) :: row(size(q)), slope
    type(rotation_type), allocatable :: turn
    integer :: b, j

    if (self%exact) turn = new_rotation(cmplx(q(4:6), 0.0_wp, wp))
    left = weight
    tangent = 0.0_wp
    do j = 1, size(self%springs)
      call place(self%springs(j), q, d(j), row, turn)
      call force_of(self%springs(j), d(j), carried(j), slope)
      carried(j) = kept(j)*carried(j) - waiting(j)
      left = left - row*carried(j)
      do b = 1, size(q)
        tangent(:, b) = tangent(:, b) + (kept(j)*slope*row(b))*row
      end do
      if (self%exact .and. .not. self%springs(j)%turning) then
        tangent(4:6, 4:6) = tangent(4:6, 4:6) + carried(j)*bend_of(self%springs(j), q(4:6))
      end if
    end do
    tangent = (tangent + transpose(tangent))/2.0_wp
  end subroutine balance

  !> Deflection of a spring, and its derivatives: e . (u + R p - p) and T^T (p x R^T e).
  pure subroutine place(spring, q, d, row, turn)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: q(:)
    real(wp), intent(out) :: d, row(:)
    !> The rotation; not present: rotations are small.
    type(rotation_type), intent(in), optional :: turn
    complex(wp) :: p(3)

    row = row_of(spring, size(q))
    d = sum(row*q)
    if (spring%turning .or. .not. present(turn)) return
    p = spring%arm
    d = d + sum(spring%direction*real(turn%moved(p)))
    row(4:6) = real(slope_by_turning(spring, turn))
  end subroutine place

  pure function slope_by_turning(spring, turn) result(slope)
    type(body_spring), intent(in) :: spring
    type(rotation_type), intent(in) :: turn
    complex(wp) :: slope(3), e(3), p(3)
    e = spring%direction
    p = spring%arm
    slope = turn%spin_transposed(cross(p, turn%turned_back(e)))
  end function slope_by_turning

  !> Second derivatives of a deflection by theta.
  pure function bend_of(spring, theta) result(bend)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: theta(3)
    real(wp) :: bend(3, 3)
    complex(wp) :: along(3)
    integer :: b
    do b = 1, 3
      along = theta
      along(b) = cmplx(theta(b), tiny_step, wp)
      bend(:, b) = aimag(slope_by_turning(spring, new_rotation(along)))/tiny_step
    end do
  end function bend_of

  !> System for small rotations about static equilibrium. The geometric stiffness of preloads is
  !! added to the springs without memory.
  subroutine build_small(self, kernels, rest, system, status)
    type(mounted_body), intent(in) :: self
    type(kernel_holder), intent(in) :: kernels(:)
    type(rest_type), intent(in) :: rest
    type(polynomial_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(polynomial_parameters) :: p
    type(body_spring) :: seen(size(self%springs))
    real(wp) :: rows(size(self%springs), self%n_dof())
    integer :: b, i, j, n

    n = self%n_dof()
    p%mass = self%masses()
    p%base_direction = self%base_direction
    allocate (p%damping(n, n), p%stiffness(n, n, size(kernels) + 1), source=0.0_wp)
    p%spring_kernel = [(i, i=0, size(kernels))]
    allocate (p%laws(0))
    p%damping(4:6, 4:6) = gyroscopic(self%spin)
    if (any(abs(self%rotor) > 0.0_wp)) then
      allocate (p%gyroscopic(n, n), p%circulatory(n, n), p%centrifugal(n, n), source=0.0_wp)
      p%gyroscopic(4:6, 4:6) = gyroscopic(self%rotor)
    end if
    if (any(abs([self%spin, self%gravity]) > 0.0_wp)) then
      ! Neither the weight nor h rotates with a floor: relative to it, -phi x W is added.
      allocate (p%space_damping(n, n), p%space_stiffness(n, n), source=0.0_wp)
      p%space_damping(4:6, 4:6) = gyroscopic(self%spin)
      p%space_stiffness(1:3, 4:6) = gyroscopic(self%mass*self%gravity)
    end if
    do i = 1, size(self%track_damping)
      p%damping(6 + i, 6 + i) = self%track_damping(i)
    end do
    do j = 1, size(seen)
      seen(j) = spring_about(self%springs(j), rest%d(j))
      rows(j, :) = row_of(seen(j), n)
      i = seen(j)%kernel + 1
      do b = 1, n
        p%damping(:, b) = p%damping(:, b) + (seen(j)%damping*rows(j, b))*rows(j, :)
        p%stiffness(:, b, i) = p%stiffness(:, b, i) + (seen(j)%stiffness*rows(j, b))*rows(j, :)
      end do
      call add_laws_of(seen(j), rows(j, :), p%laws)
    end do
    p%stiffness(4:6, 4:6, 1) = p%stiffness(4:6, 4:6, 1) + preload_stiffness(seen, rest%carried)
    call add_products(seen, rows, size(kernels), p)
    call new_polynomial(system, p, kernels, status)
  end subroutine build_small

  !> Matrix of the torque w x h = -h x w that a rotation at the rate w needs.
  pure function gyroscopic(h) result(matrix)
    real(wp), intent(in) :: h(3)
    real(wp) :: matrix(3, 3)
    matrix(:, 1) = [0.0_wp, -h(3), h(2)]
    matrix(:, 2) = [h(3), 0.0_wp, -h(1)]
    matrix(:, 3) = [-h(2), h(1), 0.0_wp]
  end function gyroscopic

  !> Stiffness against rotations by forces of constant size and direction, which has no memory: a
  !! force F at a body point p does the work F . (theta x p + theta x (theta x p)/2).
  pure function preload_stiffness(springs, carried) result(bend)
    type(body_spring), intent(in) :: springs(:)
    real(wp), intent(in) :: carried(:)
    real(wp) :: bend(3, 3), force(3)
    integer :: b, j
    bend = 0.0_wp
    do j = 1, size(springs)
      if (springs(j)%turning) cycle
      force = -carried(j)*springs(j)%direction
      associate (p => springs(j)%arm)
        do b = 1, 3
          bend(:, b) = bend(:, b) - (p*force(b) + force*p(b))/2.0_wp
          bend(b, b) = bend(b, b) + sum(p*force)
        end do
      end associate
    end do
  end function preload_stiffness

  !> The spring of a turned body in axes parallel to the floor: its arm is R p, and the deflection
  !! of a rotational mount is along R T^-T e.
  function spring_turned(spring, turn) result(seen)
    type(body_spring), intent(in) :: spring
    type(rotation_type), intent(in) :: turn
    type(body_spring) :: seen
    complex(wp) :: v(3)

    seen = spring
    if (spring%turning) then
      v = spring%direction
      v = turn%unspin_transposed(v)
      seen%direction = real(turn%turned(v))
    else
      v = spring%arm
      seen%arm = real(turn%turned(v))
    end if
  end function spring_turned

  !> The springs about the static equilibrium, with laws of d and its rate.
  function springs_at_rest(self, rest) result(seen)
    type(mounted_body), intent(in) :: self
    type(rest_type), intent(in) :: rest
    type(body_spring) :: seen(size(self%springs))
    integer :: j
    do j = 1, size(seen)
      seen(j) = spring_at(self%springs(j), rest%d(j))
      if (self%exact) then
        seen(j) = spring_turned(seen(j), new_rotation(cmplx(rest%q(4:6), 0.0_wp, wp)))
      end if
    end do
  end function springs_at_rest

  !> Add nonpolynomial laws to all equations on which the spring acts.
  subroutine add_laws_of(spring, row, laws)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: row(:)
    type(law_term), allocatable, intent(inout) :: laws(:)
    type(law_term), allocatable :: more(:)
    integer :: i, j

    do j = 1, size(spring%laws)
      allocate (more(size(laws) + 1))
      do i = 1, size(laws)
        more(i) = laws(i)
      end do
      associate (law => more(size(more)))
        law = spring%laws(j)
        deallocate (law%arguments, law%rates)
        allocate (law%arguments(2, size(row)), law%rates(2, size(row)), source=0.0_wp)
        law%arguments(1, :) = row
        law%rates(2, :) = row
        law%equations = pack([(i, i=1, size(row))], abs(row) > 0.0_wp)
        law%weights = row(law%equations)
        allocate (law%variables(size(law%equations)), source=0)
        call law%drop_unread()
      end associate
      call move_alloc(more, laws)
    end do
  end subroutine add_laws_of

  !> System for finite rotations about static equilibrium, in axes parallel to the floor.
  subroutine build_turning(self, kernels, rest, system)
    type(mounted_body), intent(in) :: self
    type(kernel_holder), intent(in) :: kernels(:)
    type(rest_type), intent(in) :: rest
    type(turning_body), intent(out) :: system
    type(body_spring) :: seen(size(self%springs))
    type(rotation_type) :: turn
    real(wp) :: mass(self%n_dof(), self%n_dof()), damping(self%n_dof(), self%n_dof())
    real(wp) :: axes(3, 3), row(self%n_dof())
    integer :: b, j

    turn = new_rotation(cmplx(rest%q(4:6), 0.0_wp, wp))
    axes = rest%axes(.true.)
    mass = self%masses()
    mass(4:6, 4:6) = matmul(axes, matmul(self%inertia, transpose(axes)))
    mass = (mass + transpose(mass))/2.0_wp
    damping = 0.0_wp
    damping(4:6, 4:6) = gyroscopic(matmul(axes, self%spin))
    do j = 1, size(self%track_damping)
      damping(6 + j, 6 + j) = self%track_damping(j)
    end do
    do j = 1, size(seen)
      seen(j) = spring_about(self%springs(j), rest%d(j))
      do b = 1, size(seen(j)%laws)
        call seen(j)%laws(b)%drop_unread()
      end do
      seen(j)%preload = rest%carried(j)
      seen(j) = spring_turned(seen(j), turn)
      row = row_of(seen(j), size(row))
      do b = 1, size(row)
        damping(:, b) = damping(:, b) + (seen(j)%damping*row(b))*row
      end do
    end do
    call new_turning_body(system, mass, damping, self%base_direction, seen, kernels)
    system%loads_turn = self%loads_turn
    system%spin_inside = matmul(axes, self%spin)
  end subroutine build_turning

end module viscovib_mounted_body
